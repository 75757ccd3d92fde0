"""What the drawn parts of a page are told: layers, lanes and charts. It needs nothing: the first look waits for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Lane:
    """One line of marks.

    Attributes:
        name: what it holds, in a word.
        mark: shape of its marks, so that they are told apart without colour.
        about: what it holds, in a sentence.
    """

    name: str
    mark: str
    about: str


LANES: tuple[Lane, ...] = (
    Lane(name="plans", mark="circle", about="A robot proposed a plan or took over another's"),
    Lane(name="swaps", mark="diamond", about="A robot claimed another place than before"),
    Lane(name="retries", mark="triangle", about="A model's answer was refused and the model asked again"),
    Lane(name="fallbacks", mark="square", about="No answer was of use: geometry, or no plan at all, took its place"),
    Lane(name="shield", mark="cross", about="A way was bent, held or given up for safety"),
    Lane(name="faults", mark="bolt", about="A robot died or joined, a call failed, a message was refused"),
    Lane(name="missions", mark="flag", about="A robot heard of another mission"),
)

LAYERS: tuple[tuple[str, str, bool], ...] = (
    ("trails", "Trails", True),
    ("goals", "Goals", True),
    ("links", "Links", True),
    ("plans", "Plan letters", True),
    ("influence", "Influence", False),
    ("safety", "Safety discs", False),
    ("cells", "Voronoi cells", False),
)
"""Layers of the arena: name, what people read, and whether it is on at first."""

CHARTS: tuple[dict[str, Any], ...] = (
    {"title": "Shape error [units]", "series": [{"figure": "procrustes_mean", "name": ""}]},
    {
        "title": "Plans, goals",
        "series": [{"figure": "plans_in_use", "name": "plans"}, {"figure": "distinct_goals", "name": "goals"}],
    },
    {"title": "Separation [units]", "edge": "safe_distance", "series": [{"figure": "segment_separation", "name": ""}]},
    {"title": "Model calls", "series": [{"figure": "model_calls", "name": ""}]},
    {"title": "Cost [$]", "series": [{"figure": "cost_usd", "name": ""}]},
)


@dataclass(frozen=True, slots=True)
class Part:
    """One drawn part.

    Attributes:
        kind: arena, timeline or plots.
        options: what this kind of part is told: the runs that it shows, the clock that it shares, and more.
    """

    kind: str
    options: dict[str, Any]


def arena(key: str, title: str, clock: str = "main") -> Part:
    """The team from above."""
    layers = {name: on for name, _, on in LAYERS}
    return Part("arena", {"keys": [key], "clock": clock, "title": title, "layers": layers})


def timeline(keys: Sequence[str], clock: str = "main") -> Part:
    """Rounds, marks and the cursor."""
    lanes = [{"name": lane.name, "mark": lane.mark, "about": lane.about} for lane in LANES]
    return Part("timeline", {"keys": list(keys), "clock": clock, "lanes": lanes})


def plots(keys: Sequence[str], clock: str = "main") -> Part:
    """Figures over rounds."""
    return Part("plots", {"keys": list(keys), "clock": clock, "charts": list(CHARTS)})
