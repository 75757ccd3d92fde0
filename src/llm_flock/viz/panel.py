"""A picture of the team at one moment, used in figures and animations."""

# Matplotlib's types leave **kwargs open.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon, Rectangle
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from llm_flock import graph
from llm_flock.record.palette import NO_PLAN
from llm_flock.record.reader import RunRecord
from llm_flock.record.schema import ASLEEP, DEAD, SILENT, State
from llm_flock.viz.style import FAINT, INK, PAPER, WITHOUT_PLAN, PlanLook, plan_looks

MOST_LABELLED = 30
SMALLEST_LABELLED = 6.5
"""With more robots, or smaller discs [points], letters and numbers are left out: they would cover each other."""

DISC_SHARE = 0.62
"""Diameter of a disc as a share of the spacing, so that neighbours in a formation stand apart."""

Box = tuple[float, float, float, float]
"""Left, right, bottom, top [units]."""


class Panel:
    """Draws moments of one record, all in the same window and with the same looks. Shows the first two dimensions.

    Args:
        record: the run.
        width: width of the picture [points]; robots and words are sized by it.
        window: the visible area [units]; by default everything that the run touches.
    """

    def __init__(self, record: RunRecord, *, width: float = 165.0, window: Box | None = None) -> None:
        self.record = record
        self.looks = plan_looks(record)
        self.window = view(record) if window is None else window
        n = record.positions.shape[1]
        spacing = float(record.mission.mission["spacing"]) * width / (self.window[1] - self.window[0])
        self._disc = max(3.5, min(width / 17.0, DISC_SHARE * spacing))
        self._font = min(7.5, 0.6 * self._disc)
        self.labelled = n <= MOST_LABELLED and self._disc >= SMALLEST_LABELLED
        self._path = record.positions[:, :, :2]

    def draw(self, axes: Axes, round_number: int, part: float = 1.0) -> None:
        """Draw the team on clean axes, after a `part` of the round; robots fly straight from round to round."""
        self.frame(axes)
        self.draw_team(axes, round_number, part)

    def frame(self, axes: Axes) -> None:
        """Prepare the axes: this panel's window, the arena's walls, and the obstacles."""
        left, right, bottom, top = self.window
        axes.set_xlim(left, right)
        axes.set_ylim(bottom, top)
        axes.set_aspect("equal")
        axes.tick_params(length=2)
        # Obstacles of 3D space are shown by their projection on the plane.
        mission = self.record.mission.mission
        (left, bottom, *_), (right, top, *_) = mission["arena"]
        look: dict[str, Any] = {"edgecolor": FAINT, "linewidth": 0.8, "zorder": 0.5}
        axes.add_patch(Rectangle((left, bottom), right - left, top - bottom, facecolor="none", **look))
        for obstacle in mission.get("obstacles", ()):
            if obstacle.get("polygon") is not None:
                axes.add_patch(Polygon(obstacle["polygon"], closed=True, facecolor=FAINT, **look))
            else:
                axes.add_patch(Circle(obstacle["center"][:2], obstacle["radius"], facecolor=FAINT, **look))

    def draw_team(self, axes: Axes, round_number: int, part: float = 1.0) -> None:
        """As `draw`, on axes that `frame` has prepared."""
        state = self.record.states[round_number]
        before = self.record.positions[max(0, round_number - 1)]
        positions = before + part * (self.record.positions[round_number] - before)
        places = positions[:, :2]
        looks = [self.looks[plan_id] for plan_id in state.plan_ids]
        self._links(axes, state, positions)
        self._trails(axes, round_number, places)
        self._goals(axes, state, looks)
        self._robots(axes, state, places, looks)

    def _links(self, axes: Axes, state: State, positions: NDArray[np.float64]) -> None:
        """Radio links, by distance in all dimensions; robots that only look near in the picture are not joined."""
        adjacent = graph.adjacency(positions, float(self.record.mission.mission["comm_range"]))
        silent = [robot for robot, phase in enumerate(state.phases) if phase in SILENT]
        adjacent[silent, :] = adjacent[:, silent] = False
        pairs = np.argwhere(np.triu(adjacent))
        axes.add_collection(LineCollection(list(positions[:, :2][pairs]), colors=FAINT, linewidths=0.8, zorder=1))

    def _trails(self, axes: Axes, round_number: int, places: NDArray[np.float64]) -> None:
        """Each leg in the colour of the plan that was followed on it."""
        path = np.concatenate([self._path[:round_number], places[None]])
        legs: list[NDArray[np.float64]] = []
        colours: list[str] = []
        for k in range(1, round_number + 1):
            legs.extend(path[k - 1 : k + 1].transpose(1, 0, 2))
            colours.extend(self.looks[plan_id].line for plan_id in self.record.states[k].plan_ids)
        axes.add_collection(LineCollection(legs, colors=colours, linewidths=0.9, alpha=0.8, zorder=2))
        start = self._path[0]
        axes.scatter(start[:, 0], start[:, 1], s=min(3.0, 0.25 * self._disc), c=INK, linewidths=0, zorder=2)

    def _goals(self, axes: Axes, state: State, looks: Sequence[PlanLook]) -> None:
        rings = [(goal, look.line) for goal, look in zip(state.goals, looks, strict=True) if goal is not None]
        if rings:
            points = np.array([goal[:2] for goal, _ in rings])
            axes.scatter(
                points[:, 0],
                points[:, 1],
                s=(1.4 * self._disc) ** 2,
                facecolors="none",
                edgecolors=[colour for _, colour in rings],
                linewidths=min(1.0, 0.15 * self._disc),
                zorder=3,
            )

    def _robots(self, axes: Axes, state: State, places: NDArray[np.float64], looks: Sequence[PlanLook]) -> None:
        dead = [robot for robot, phase in enumerate(state.phases) if phase == DEAD]
        if dead:
            axes.scatter(places[dead, 0], places[dead, 1], s=self._disc**2, c=INK, marker="x", linewidths=1.2, zorder=5)
        alive = [robot for robot in range(len(looks)) if robot not in dead]
        if not self.labelled:
            self._discs(axes, places[alive], [looks[robot] for robot in alive], 4.0)
            return
        for robot in alive:
            look = looks[robot]
            # Each disc lies wholly above the last, so that no letter shows on another disc.
            above = 4.0 + robot / len(looks)
            at = (float(places[robot, 0]), float(places[robot, 1]))
            self._discs(axes, places[robot : robot + 1], [look], above)
            letter = self._font * (1.1 if len(look.name) == 1 else 0.8)
            axes.annotate(
                look.name,
                at,
                size=letter,
                weight="bold",
                color=look.ink,
                ha="center",
                va="center_baseline",
                zorder=above,
            )
            if state.phases[robot] == ASLEEP:
                continue
            axes.annotate(
                short(state.influence[robot]),
                at,
                xytext=(0, 0.72 * self._disc),
                textcoords="offset points",
                size=self._font,
                ha="center",
                va="bottom",
                path_effects=[withStroke(linewidth=0.25 * self._font, foreground=PAPER)],
                zorder=6,
            )

    def _discs(self, axes: Axes, places: NDArray[np.float64], looks: Sequence[PlanLook], above: float) -> None:
        axes.scatter(
            places[:, 0],
            places[:, 1],
            s=self._disc**2,
            c=[look.fill for look in looks],
            edgecolors=INK,
            linewidths=min(0.8, 0.1 * self._disc),
            linestyle=[look.rim for look in looks],
            zorder=above,
        )

    def key(self) -> list[Line2D | Patch]:
        """Entries of a legend."""
        look = next((look for plan_id, look in self.looks.items() if plan_id is not None), WITHOUT_PLAN)
        what = " (letter and colour: its plan; number above: its influence)" if self.labelled else " (colour: plan)"
        phases = {phase for state in self.record.states for phase in state.phases}
        silent: list[Line2D | Patch] = []
        if DEAD in phases:
            silent.append(Line2D([], [], marker="x", ls="", ms=6, mec=INK, mew=1.2, label="dead robot"))
        if ASLEEP in phases:
            look_asleep: dict[str, Any] = {"mfc": NO_PLAN, "mec": INK, "mew": 0.8}
            silent.append(Line2D([], [], marker="o", ls="", ms=7, label="not begun yet", **look_asleep))
        return [
            Line2D([], [], marker="o", ls="", ms=7, mfc=look.fill, mec=INK, mew=0.8, label="robot" + what),
            Line2D([], [], marker="o", ls="", ms=9, mfc="none", mec=look.line, mew=1.1, label="goal"),
            Line2D([], [], color=look.line, lw=1.2, label="flown path, from the dot"),
            Line2D([], [], color=FAINT, lw=1.2, label="within radio range"),
            *silent,
        ]


def short(share: float) -> str:
    """A number from 0 to 1 with two decimals in as few characters as possible: 0, .25, 1."""
    return f"{share:.0f}" if share in (0.0, 1.0) else f"{share:.2f}".removeprefix("0")


def view(record: RunRecord, margin: float = 0.08) -> Box:
    """The arena, extended to every robot and goal outside, with a margin [units]."""
    low, high = (np.array(corner[:2], dtype=np.float64) for corner in record.mission.mission["arena"])
    goals = [goal[:2] for state in record.states for goal in state.goals if goal is not None]
    points = np.concatenate([record.positions[:, :, :2].reshape(-1, 2), np.array(goals).reshape(-1, 2)])
    low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
    pad = margin * float((high - low).max())
    return (float(low[0]) - pad, float(high[0]) + pad, float(low[1]) - pad, float(high[1]) + pad)
