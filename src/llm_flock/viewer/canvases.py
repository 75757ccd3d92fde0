"""The canvases of a page and their options. Imports nothing heavy: the first page waits for it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

TRACKS: tuple[dict[str, str], ...] = (
    {"name": "plans", "mark": "circle", "about": "A robot proposed a plan or took over another's"},
    {"name": "swaps", "mark": "diamond", "about": "A robot claimed another place than before"},
    {"name": "retries", "mark": "triangle", "about": "A model's answer was refused and the model asked again"},
    {
        "name": "fallbacks",
        "mark": "square",
        "about": "No answer was of use: geometry, or no plan at all, took its place; a circuit breaker switched",
    },
    {"name": "shield", "mark": "cross", "about": "A way was bent, held or given up for safety"},
    {"name": "faults", "mark": "bolt", "about": "A robot died or joined, a call failed, a message was refused"},
    {"name": "missions", "mark": "flag", "about": "A robot heard of another mission"},
)
"""Rows of marks on the timeline; the shape of a mark tells them apart without colour."""

LAYERS: tuple[tuple[str, str, bool], ...] = (
    ("trails", "Trails", True),
    ("goals", "Goals", True),
    ("links", "Links", True),
    ("plans", "Plan letters", True),
    ("influence", "Influence", False),
    ("safety", "Safety discs", False),
    ("cells", "Voronoi cells", False),
)
"""Layers of the arena: name, label, and whether it is on at first."""

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


class Canvas(NamedTuple):
    """A canvas: arena, timeline or plots, and its options; canvases of one page share a clock."""

    kind: str
    options: dict[str, Any]


def arena(key: str, title: str) -> Canvas:
    """The team from above."""
    layers = {name: on for name, _, on in LAYERS}
    return Canvas("arena", {"keys": [key], "clock": "main", "title": title, "layers": layers})


def timeline(keys: Sequence[str]) -> Canvas:
    """Rounds, marks and the cursor."""
    return Canvas("timeline", {"keys": list(keys), "clock": "main", "tracks": TRACKS})


def plots(keys: Sequence[str]) -> Canvas:
    """Measurements over rounds."""
    return Canvas("plots", {"keys": list(keys), "clock": "main", "charts": CHARTS})
