"""The drawn parts as elements of a page: arena, time line and plots share one clock in the browser."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from nicegui.element import Element

from llm_flock.viewer.happenings import LANES

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


class Drawing(Element, component="static/panel.js", esm={"llm-flock-viewer": "static"}):
    """One drawn part.

    Args:
        kind: arena, timeline or plots.
        keys: runs that it shows; an arena shows one.
        clock: name of the clock, shared by the parts of a page.
        options: what else this kind of part needs.
    """

    def __init__(self, kind: str, keys: Sequence[str], clock: str = "main", **options: Any) -> None:
        super().__init__()
        self._props["kind"] = kind
        self._props["options"] = {"keys": list(keys), "clock": clock, **options}

    def tell(self, name: str, *given: Any) -> None:
        """Call a method of the part in the browser."""
        self.run_method("call", name, *given)


def arena(key: str, title: str, clock: str = "main") -> Drawing:
    """The team from above."""
    return Drawing("arena", [key], clock, title=title, layers={name: on for name, _, on in LAYERS})


def timeline(keys: Sequence[str], clock: str = "main") -> Drawing:
    """Rounds, marks and the cursor."""
    lanes = [{"name": lane.name, "mark": lane.mark, "about": lane.about} for lane in LANES]
    return Drawing("timeline", keys, clock, lanes=lanes)


def plots(keys: Sequence[str], clock: str = "main") -> Drawing:
    """Figures over rounds."""
    return Drawing("plots", keys, clock, charts=list(CHARTS))
