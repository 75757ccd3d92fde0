"""What the model on board was taught, and what was held out; the examples are made by `benchmarks.lessons`."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import lru_cache
from importlib.resources import files
from typing import Any

from llm_flock.errors import InputError
from llm_flock.mission import Mission, build_mission

CURRICULUM: Mapping[str, Any] = tomllib.loads(
    files("llm_flock_onboard._distill").joinpath("curriculum.toml").read_text(encoding="utf-8")
)
"""Shapes, sizes and wordings of `curriculum.toml`."""


def plan_mission(shape: str, n: int, **more: Any) -> Mission:
    """A mission of this team; in the own frame all its centres and spacings give the same question."""
    dim = len(more.get("points", [(0.0, 0.0)])[0])
    arena = ((-900.0,) * dim, (900.0,) * dim)
    return build_mission(shape=shape, n_robots=n, center=(0.0,) * dim, comm_range=99.0, arena=arena, **more)


@lru_cache(maxsize=2)
def taught_teams(*, held_out: bool = False) -> tuple[tuple[str, int], ...]:
    """Shapes and sizes of the plans that are taught, or of those that are not."""
    given, found = CURRICULUM["plans"], list[tuple[str, int]]()
    for shape in (*given["shapes"], *given["held_out_shapes"]):
        for n in range(3, given["largest"] + 1):
            kept = shape in given["held_out_shapes"] or n in given["held_out_sizes"]
            if kept == held_out and _legal(shape, n):
                found.append((shape, n))
    return tuple(found)


def _legal(shape: str, n: int) -> bool:
    try:
        plan_mission(shape, n)
    except InputError:
        return False
    return True
