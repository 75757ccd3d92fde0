"""Legends of figures and animations, in the viewer's words, for the marks drawn in the rounds shown."""

# Matplotlib's types leave **kwargs open.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, TypeAlias

import numpy as np
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.path import Path
from matplotlib.textpath import TextPath

from llm_flock.record import ASLEEP, DEAD
from llm_flock_view._figures.labels import size_of
from llm_flock_view._figures.panel import TIMES, Panel
from llm_flock_view._figures.style import DANGER, FAINT, INK, NOT_BEGUN, QUIET, WITHOUT_PLAN, PlanLook

Entry: TypeAlias = Line2D | Patch | PathCollection

LEGEND_EMS = 4.2  # width of a sign in a legend with the room around it, in sizes of its letters
SIGN = 7.0  # diameter of a robot in a legend [points]


def key_of(shown: Iterable[tuple[Panel, Iterable[int]]]) -> list[Entry]:
    """Entries of a legend for panels and the rounds that they show, each once, always in the same order."""
    found: dict[int, Entry] = {}
    for panel, rounds in shown:
        for place, entry in enumerate(_entries(panel, list(rounds))):
            if entry is not None:
                found.setdefault(place, entry)
    return [found[place] for place in sorted(found)]


def columns_of(entries: Sequence[Entry], inches: float, size: float) -> int:
    """Most columns of a legend with letters of a `size` [points] that fit a width; entries fill column after column."""
    widths = [size_of(str(entry.get_label()), size)[0] + LEGEND_EMS * size for entry in entries]
    for columns in range(len(widths), 1, -1):
        rows, longer = divmod(len(widths), columns)
        lengths = [rows + (k < longer) for k in range(columns)]
        firsts = [sum(lengths[:k]) for k in range(columns)]
        if sum(max(widths[i : i + n]) for i, n in zip(firsts, lengths, strict=True)) <= 72.0 * inches:
            return columns
    return 1


def _entries(panel: Panel, rounds: Sequence[int]) -> list[Entry | None]:
    """Every sign at its place in the legend; None for one that no round shows."""
    record, mission = panel.record, panel.record.mission.mission
    states = [record.states[k] for k in rounds]
    awake = [(s, k) for s in states for k, phase in enumerate(s.phases) if phase not in (DEAD, ASLEEP)]
    flown = {state.plan_ids[k]: panel.looks[state.plan_ids[k]] for state, k in awake}
    looks = [look for plan_id, look in flown.items() if plan_id is not None]
    phases = {phase for state in states for phase in state.phases}
    look = looks[0] if looks else WITHOUT_PLAN
    goals = any(goal is not None for state in states for goal in state.goals)
    near = any(len(panel.close_pairs(record.positions[k])) for k in rounds)
    hidden = {one for k in rounds for one in panel.crowded(k)}
    number = ", with its number" if panel.labelled else ""
    ring: dict[str, Any] = {"marker": "o", "mfc": "none"}
    return [
        _disc(look, "robot, in its plan's colour") if looks else None,
        _tag(look.name, look.fill, "letter of its plan, then its influence") if looks and panel.labelled else None,
        _disc(replace(look, rim="--"), "dashed rim: another plan, its colour used again")
        if any(one.rim != "-" for one in looks)
        else None,
        _disc(WITHOUT_PLAN, "robot without a plan") if None in flown else None,
        Line2D([], [], **ring, ls="", ms=9, mec=look.line, mew=1.1, label="ring: its goal") if goals else None,
        Line2D([], [], color=look.line, lw=1.2, marker=".", ms=4, mfc=INK, mec=INK, label="its way, from the dot")
        if any(rounds)
        else None,
        Line2D([], [], color=FAINT, lw=1.2, label="radio link"),
        Patch(facecolor="none", edgecolor=INK, lw=0.7, label="this panel, on the map of all") if panel.mapped else None,
        Line2D([], [], marker="o", ls="", ms=SIGN, mfc=INK, mec=INK, label=f"dead ({TIMES}){number}")
        if DEAD in phases
        else None,
        _disc(NOT_BEGUN, "has not begun yet") if ASLEEP in phases else None,
        Patch(facecolor=FAINT, edgecolor=FAINT, label="obstacle") if mission.get("obstacles") else None,
        Line2D([], [], **ring, ls="-", c=DANGER, ms=8, mec=DANGER, mew=1.4, label="nearer than the safe distance")
        if near
        else None,
        _tag(f"2{TIMES}", DANGER, "hide one another: too near") if True in hidden else None,
        _tag(f"2{TIMES}", QUIET, "hide one another, as one above the other: not too near") if False in hidden else None,
    ]


def _disc(look: PlanLook, words: str) -> Entry:
    """A robot as panels draw it: lines of a legend have no dashed rims."""
    rim: dict[str, Any] = {"edgecolors": INK, "linewidths": 0.8, "linestyle": look.rim}
    return Figure().add_subplot().scatter([], [], s=SIGN**2, c=look.fill, label=words, **rim)


def _tag(text: str, colour: str, words: str) -> Line2D:
    return Line2D([], [], marker=_stencil(text), ls="", ms=11, mfc=colour, mew=0.0, label=words)


@cache
def _stencil(text: str) -> Path:
    """A tag with its letters cut out, so that the paper shows through."""
    letters: Any = TextPath((0, 0), text, size=10, prop=FontProperties(family="DejaVu Sans", weight="bold"))
    low, high = letters.get_extents().get_points()
    pad, (x, y) = 2.0, (low + high) / 2
    wide, tall = (high - low) / 2 + pad
    # The outlines of letters run the other way round than this frame.
    frame = Path([(-wide, -tall), (wide, -tall), (wide, tall), (-wide, tall), (-wide, -tall)], closed=True)
    moved = Path(np.asarray(letters.vertices) - [x, y], letters.codes)
    return Path.make_compound_path(frame, moved)
