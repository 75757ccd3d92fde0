"""A trial as a sweep stores it, without a run."""

from __future__ import annotations

from typing import Any

from llm_flock.runtime._config import build_config
from llm_flock_lab._experiments import tables
from llm_flock_lab._experiments.trial import TrialResult


def stored_trial(name: str, *, seed: int = 0, cell: str = "triangle/3 flock", **fields: Any) -> TrialResult:
    plain: dict[str, Any] = {
        "id": name,
        "cell": cell,
        "axes": {},
        "config": build_config(shape="triangle", n_robots=3, seed=seed).model_dump(mode="json"),
        "summary": None,
        "rounds": {column.name: [] for column in tables.ROUNDS[1:]},
        "error": "ValueError: no",
        "cut": False,
        "simulated": True,
        "code": "0",
    }
    return TrialResult(**{**plain, **fields})
