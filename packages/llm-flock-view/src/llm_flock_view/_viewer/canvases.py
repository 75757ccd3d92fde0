"""Contents of a page's canvases: tracks, layers and charts. Imports nothing heavy: the first page waits for it."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from typing import Any

from llm_flock.printable import printable
from llm_flock_view._viewer.paths import RECORD_NAME

TOO_CLOSE = "too close"  # track of the timeline that counts pairs nearer than the safe distance

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
    {"name": TOO_CLOSE, "mark": "pair", "about": "Pairs of robots nearer than the safe distance, counted"},
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
        "whole": True,
        "series": [{"figure": "plans_in_use", "name": "plans"}, {"figure": "distinct_goals", "name": "goals"}],
    },
    {"title": "Separation [units]", "edge": "safe_distance", "series": [{"figure": "segment_separation", "name": ""}]},
    {"title": "Model calls", "whole": True, "series": [{"figure": "model_calls", "name": ""}]},
    {"title": "Cost [$]", "series": [{"figure": "cost_usd", "name": ""}]},
)


PAGE_NAME = "replay.html"
FIGURES = ("png", "svg", "pdf")
"""Kinds of figures that a page saves."""


def export_kinds() -> list[tuple[str, str]]:
    """Labels and file names of what this machine can make of a record."""
    found = [
        ("Record (MCAP)", RECORD_NAME),
        ("Replay (HTML)", PAGE_NAME),
        *((f"Figure ({ending.upper()})", f"snapshots.{ending}") for ending in FIGURES),
        ("Animation (GIF)", "animation.gif"),
    ]
    return [*found, ("Animation (MP4)", "animation.mp4")] if shutil.which("ffmpeg") else found


def player_options(runs: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """Options of the page of one run or two: key and title of each."""
    return {
        "page": "player",
        "runs": [{"key": key, "title": printable(title)} for key, title in runs],
        "tracks": TRACKS,
        "layers": LAYERS,
        "charts": CHARTS,
        "exports": export_kinds(),
    }
