"""Faults of real small models as data: what they wrote, and how often, in `small_models.toml`."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from itertools import cycle
from string import Template
from typing import Any

import numpy as np

from llm_flock.llm._simulated.prompt_reader import PLAN_MARK, STEP_MARK

_DATA: Mapping[str, Mapping[str, Any]] = tomllib.loads(
    files(__package__ or "").joinpath("small_models.toml").read_text(encoding="utf-8")
)

SEEN: Mapping[str, str] = {name: fault["says"] for name, fault in _DATA["faults"].items()}
"""Every fault that was seen, and what it is. An answer has one of them at most."""

AFTER_REJECTION = frozenset(name for name, fault in _DATA["faults"].items() if fault.get("retry"))
"""Faults that need a rejected answer."""

SMALL_MODELS: Mapping[str, Mapping[str, float]] = {
    name: {fault: count / seen["answers"] for fault, count in seen.items() if fault != "answers"}
    for name, seen in _DATA.get("models", {}).items()
}
"""Share of the answers of each model that had each fault."""

_REJECTED = "This answer cannot be used: "
_ROW = re.compile(r"\[[^\[\]]*\]")
_NUMBER = re.compile(r"-?[0-9]+(?:\.[0-9]+)?")
_PLACE = re.compile(r"(my[ _]plan\"?: )([0-9]+)")


def is_retry(talk: Sequence[tuple[str, str]]) -> bool:
    """Whether a conversation of (role, text) ends with a correction."""
    return len(talk) > 2 and talk[-1][1].startswith(_REJECTED)


def spoiled(fault: str, right: str, talk: Sequence[tuple[str, str]], rng: np.random.Generator) -> str:
    """An answer with this fault, made of a right one, where `talk` is the conversation of (role, text)."""
    texts: Sequence[str] = _DATA["faults"][fault]["texts"]
    asked = next(text for _, text in reversed(talk) if PLAN_MARK in text or STEP_MARK in text)
    answer = right if right.startswith("{") else right.rpartition("\n\n")[2]
    told, place = cycle(_NUMBER.findall(asked)), _PLACE.search(answer)
    index = int(place[2]) if place else 0

    def rows(make: Callable[[list[str]], Sequence[str]]) -> str:
        """The answer with other numbers in each of its points."""
        return _ROW.sub(lambda row: f"[{', '.join(make(_NUMBER.findall(row[0])))}]", answer)

    first = _NUMBER.findall((_ROW.search(answer) or [answer])[0])
    values = {
        "right": answer,
        "question": asked.split("\n\n")[1],
        "form": asked.rpartition(":\n")[2],
        "correction": talk[-1][1].partition("\n")[0].removeprefix(_REJECTED),
        "before": next((text for role, text in reversed(talk) if role == "assistant"), ""),
        "number": index,
        "half": right[: len(right) * 2 // 3],
        "loop": "This is the only answer to the question.\n" * 40,
        "count": ", ".join(map(str, range(200))),
        "coincident": rows(lambda row: first if place else [next(told) for _ in row]),
        "copied": rows(lambda row: [next(told) for _ in row]),
        "chance": rows(lambda row: [f"{x:.1f}" for x in rng.uniform(0, 100, len(row))]),
        "miscounted": re.sub(r"\[(\[[^\[\]]*\]), ", "[", answer, count=1) if place else rows(lambda row: [*row, "0"]),
        "swapped": rows(lambda row: row[::-1]),
        "base": _PLACE.sub(lambda found: f"{found[1]}{index + 1}", answer),
        "units": rows(lambda row: [f"{x} m" for x in row]),
    }
    return Template(texts[int(rng.integers(len(texts)))]).substitute(values)
