"""A picture of the team at one moment, used in figures and animations."""

# Matplotlib's types leave **kwargs open.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon, Rectangle
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from llm_flock import graph
from llm_flock.arrays import Points
from llm_flock.record.palette import NO_PLAN
from llm_flock.record.reader import RunRecord
from llm_flock.record.schema import ASLEEP, DEAD, SILENT, State
from llm_flock.viz.crowd import spread
from llm_flock.viz.labels import beside, size_of
from llm_flock.viz.style import DANGER, FAINT, INK, PAPER, WITHOUT_PLAN, PlanLook, plan_looks

Looks: TypeAlias = Sequence[PlanLook]
Counts: TypeAlias = Sequence[tuple[float, float]]

MOST_LABELLED = 30
SMALLEST_LABELLED = 6.5
"""With more robots, or smaller discs [points], words are left out: there is no room for them."""

DISC_SHARE = 0.62
"""Diameter of a disc as a share of the spacing, so that neighbours in a formation stand apart."""

MOST_OF = 0.7
"""A team that takes more of the view than this share is not shown any closer."""

ROOM = (1.5, 2.1)
"""Widths of a close-up in widths of what it shows: the second where the first leaves no corner for the inset."""

MARGIN = 0.02
"""Between the inset and the middle of a disc, as a share of the panel's width."""

INSET = 0.24
"""Width and height of the inset that shows the whole view, as a share of the panel's."""

TIMES = "\u00d7"

LEGEND_EMS = 4.2
"""Width of a sign in a legend with the room around it, in sizes of its letters."""

ROUNDING = 1e-6
"""A pair that is nearer than the safe distance by less than this keeps it [units]; as in the viewer."""

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
        self._offsets: dict[int, tuple[float, float] | None] = {}

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

    def inset(self, axes: Axes, round_number: int, whole: Box) -> None:
        """A small map of the whole view in the corner with the fewest robots; shows this window and every robot."""
        left, right, bottom, top = self.window
        at = self.record.positions[round_number, :, :2]
        small = axes.inset_axes((*_corner(at, self.window)[0], INSET, INSET), zorder=7)
        Panel(self.record, window=whole).frame(small)
        small.set_xticks([])
        small.set_yticks([])
        small.scatter(at[:, 0], at[:, 1], s=1.5, c=INK, linewidths=0, zorder=5)
        small.add_patch(Rectangle((left, bottom), right - left, top - bottom, fill=False, ec=INK, lw=0.7, zorder=6))

    def draw_team(self, axes: Axes, round_number: int, part: float = 1.0) -> None:
        """Draw the team on axes that `frame` has prepared and whose place in the figure is final.

        After a `part` of the round; robots fly straight from round to round.
        """
        state = self.record.states[round_number]
        before = self.record.positions[max(0, round_number - 1)]
        positions = before + part * (self.record.positions[round_number] - before)
        places = positions[:, :2]
        looks = [self.looks[plan_id] for plan_id in state.plan_ids]
        self._links(axes, state, positions)
        self._trails(axes, round_number, places)
        self._goals(axes, state, looks)
        drawn, counts = self._spread(axes, places)
        self._too_close(axes, positions, drawn)
        self._robots(axes, state, drawn, looks, counts)

    def _spread(self, axes: Axes, places: Points) -> tuple[NDArray[np.float64], list[tuple[float, float]]]:
        """Where discs are drawn [units], and the middles of crowds, which are counted; small discs stay in place."""
        if not self.labelled:
            return places, []
        points = 72.0 / _dpi(axes)
        at, crowds = spread(points * np.asarray(axes.transData.transform(places)), self._disc / 2)
        drawn = np.asarray(axes.transData.inverted().transform(at / points))
        counts: list[tuple[float, float]] = []
        for members, middle in crowds:
            ties = np.stack([places[members], drawn[members]], axis=1)
            axes.add_collection(LineCollection(list(ties), colors=DANGER, linewidths=0.8, zorder=3.4))
            if middle is None:
                continue
            x, y = np.asarray(axes.transData.inverted().transform(middle / points)).tolist()
            counts.append((x, y))
            look: dict[str, Any] = {"boxstyle": "square,pad=0.1", "facecolor": DANGER, "edgecolor": "none"}
            name = f"{len(members)}{TIMES}"
            axes.annotate(
                name, (x, y), size=0.9 * self._font, weight="bold", color=PAPER, ha="center", va="center_baseline",
                bbox=look, zorder=6.5,
            )  # fmt: skip
        return drawn, counts

    def _too_close(self, axes: Axes, positions: NDArray[np.float64], drawn: NDArray[np.float64]) -> None:
        """Pairs nearer than the safe distance, in all dimensions, in red."""
        safe = float(self.record.mission.mission["safe_distance"])
        pairs = np.argwhere(np.triu(graph.distances(positions) < safe - ROUNDING, 1))
        if not len(pairs):
            return
        axes.add_collection(LineCollection(list(drawn[pairs]), colors=DANGER, linewidths=1.4, zorder=3.5))
        near = drawn[np.unique(pairs)]
        axes.scatter(
            near[:, 0], near[:, 1], s=(self._disc + 3.0) ** 2, facecolors="none", edgecolors=DANGER, linewidths=1.4,
            zorder=3.6,
        )  # fmt: skip

    def _links(self, axes: Axes, state: State, positions: NDArray[np.float64]) -> None:
        """Radio links, by distance in all dimensions; robots that only look near in the picture are not joined."""
        adjacent = graph.adjacency(positions, float(self.record.mission.mission["comm_range"]))
        silent = [robot for robot, phase in enumerate(state.phases) if phase in SILENT]
        adjacent[silent, :] = adjacent[:, silent] = False
        pairs = np.argwhere(np.triu(adjacent))
        axes.add_collection(LineCollection(list(positions[:, :2][pairs]), colors=FAINT, linewidths=0.8, zorder=2))

    def _trails(self, axes: Axes, round_number: int, places: Points) -> None:
        """Each leg in the colour of the plan that was followed on it."""
        path = np.concatenate([self._path[:round_number], places[None]])
        legs: list[NDArray[np.float64]] = []
        colours: list[str] = []
        for k in range(1, round_number + 1):
            legs.extend(path[k - 1 : k + 1].transpose(1, 0, 2))
            colours.extend(self.looks[plan_id].line for plan_id in self.record.states[k].plan_ids)
        axes.add_collection(LineCollection(legs, colors=colours, linewidths=0.9, alpha=0.8, zorder=1))
        start = self._path[0]
        axes.scatter(start[:, 0], start[:, 1], s=min(3.0, 0.25 * self._disc), c=INK, linewidths=0, zorder=2)

    def _goals(self, axes: Axes, state: State, looks: Looks) -> None:
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

    def _robots(self, axes: Axes, state: State, places: Points, looks: Looks, counts: Counts) -> None:
        dead = [robot for robot, phase in enumerate(state.phases) if phase == DEAD]
        if dead:
            for size, colour, marker in ((self._disc, INK, "o"), (0.5 * self._disc, PAPER, "x")):
                above = 5.0 if marker == "x" else 3.9
                axes.scatter(
                    places[dead, 0], places[dead, 1], s=size**2, c=colour, marker=marker, linewidths=1.2, zorder=above
                )
        alive = [robot for robot in range(len(looks)) if robot not in dead]
        if not self.labelled:
            self._discs(axes, places[alive], [looks[robot] for robot in alive], 4.0)
            return
        for robot in alive:
            # Each disc lies wholly above the last, so that no number shows on another disc.
            above = 4.0 + robot / len(looks)
            self._discs(axes, places[robot : robot + 1], [looks[robot]], above)
            axes.annotate(
                str(robot),
                (float(places[robot, 0]), float(places[robot, 1])),
                size=self._font * (1.1 if robot < 10 else 0.95),
                weight="bold",
                color=looks[robot].ink,
                ha="center",
                va="center_baseline",
                zorder=above,
            )
        self._words(axes, state, places, looks, counts)

    def _words(self, axes: Axes, state: State, places: Points, looks: Looks, counts: Counts) -> None:
        """Letter of the plan and influence, beside every robot that has begun; beside a dead one its number."""
        begun = [robot for robot in range(len(looks)) if state.phases[robot] != ASLEEP]
        words = {
            robot: str(robot)
            if state.phases[robot] == DEAD
            else f"{looks[robot].name} {short(state.influence[robot])}".strip()
            for robot in begun
        }
        points = 72.0 / _dpi(axes)
        order = [*begun, *(robot for robot in range(len(places)) if robot not in words)]
        (left, bottom), (right, top) = points * axes.transAxes.transform([(0, 0), (1, 1)])
        inset = [points * child.get_window_extent().get_points() for child in axes.child_axes]
        discs = points * np.asarray(axes.transData.transform(places[order]))
        found = beside(
            discs,
            0.72 * self._disc,  # with the ring of a goal
            [size_of(word, self._font) for word in words.values()],
            (left, right, bottom, top),
            [
                *((low[0], high[0], low[1], high[1]) for low, high in inset),
                *(
                    self._tag(x, y)
                    for x, y in points * np.asarray(axes.transData.transform(np.reshape(counts, (-1, 2))))
                ),
            ],
            [self._offsets.get(robot) for robot in begun],
        )
        self._offsets = dict(zip(begun, found, strict=True))
        for disc, word, offset in zip(discs, words.values(), found, strict=False):
            if offset is not None:
                axes.annotate(
                    word,
                    (disc[0] + offset[0], disc[1] + offset[1]),
                    xycoords="figure points",
                    size=self._font,
                    ha="center",
                    va="center",
                    path_effects=[withStroke(linewidth=0.25 * self._font, foreground=PAPER)],
                    zorder=6,
                )

    def _tag(self, x: float, y: float) -> tuple[float, float, float, float]:
        """The place of a crowd's number [points]."""
        return x - self._font, x + self._font, y - 0.7 * self._font, y + 0.7 * self._font

    def _discs(self, axes: Axes, places: Points, looks: Looks, above: float) -> None:
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
        what = ", coloured by its plan; beside it: plan, influence" if self.labelled else ", coloured by its plan"
        phases = {phase for state in self.record.states for phase in state.phases}
        silent: list[Line2D | Patch] = []
        if DEAD in phases:
            named = f"dead robot ({TIMES})"
            silent.append(Line2D([], [], marker="o", ls="", ms=7, mfc=INK, mec=INK, label=named))
        if ASLEEP in phases:
            look_asleep: dict[str, Any] = {"mfc": NO_PLAN, "mec": INK, "mew": 0.8}
            silent.append(Line2D([], [], marker="o", ls="", ms=7, label="not begun yet", **look_asleep))
        return [
            Line2D([], [], marker="o", ls="", ms=7, mfc=look.fill, mec=INK, mew=0.8, label="robot" + what),
            Line2D([], [], marker="o", ls="", ms=9, mfc="none", mec=look.line, mew=1.1, label="goal"),
            Line2D(
                [], [], color=look.line, lw=1.2, marker=".", ms=4, mfc=INK, mec=INK, label="flown path, from the dot"
            ),
            Line2D([], [], color=FAINT, lw=1.2, label="within radio range"),
            *silent,
            *self._warnings(),
        ]

    def _warnings(self) -> list[Line2D | Patch]:
        """Entries for what is in the way, and for robots that are too close."""
        found: list[Line2D | Patch] = []
        mission = self.record.mission.mission
        if mission.get("obstacles"):
            found.append(Patch(facecolor=FAINT, edgecolor=FAINT, label="obstacle"))
        safe = float(mission["safe_distance"])
        if any(row.min_separation is not None and row.min_separation < safe - ROUNDING for row in self.record.metrics):
            words = "nearer than the safe distance"
            found.append(
                Line2D([], [], marker="o", ls="-", c=DANGER, ms=8, mfc="none", mec=DANGER, mew=1.4, label=words)
            )
        return found


def key_of(panels: Sequence[Panel]) -> list[Line2D | Patch]:
    """Entries of a legend for several panels, each once."""
    found: dict[str, Line2D | Patch] = {}
    for panel in panels:
        for entry in panel.key():
            found.setdefault(str(entry.get_label()), entry)
    return list(found.values())


def columns_of(entries: Sequence[Line2D | Patch], inches: float, size: float) -> int:
    """Most columns of a legend with letters of a `size` [points] that fit a width; entries fill column after column."""
    widths = [size_of(str(entry.get_label()), size)[0] + LEGEND_EMS * size for entry in entries]
    for columns in range(len(widths), 1, -1):
        rows, longer = divmod(len(widths), columns)
        lengths = [rows + (k < longer) for k in range(columns)]
        firsts = [sum(lengths[:k]) for k in range(columns)]
        if sum(max(widths[i : i + n]) for i, n in zip(firsts, lengths, strict=True)) <= 72.0 * inches:
            return columns
    return 1


def _dpi(axes: Axes) -> float:
    figure = axes.figure
    assert figure is not None, "axes are part of a figure"
    return float(figure.dpi)


def short(share: float) -> str:
    """A number from 0 to 1 with two decimals in as few characters as possible: 0, .25, 1."""
    return f"{share:.0f}" if share in (0.0, 1.0) else f"{share:.2f}".removeprefix("0")


def close_up(record: RunRecord, round_number: int) -> Box | None:
    """A window on the team and its goals in one round; None where they fill most of the whole view anyway."""
    state, whole = record.states[round_number], view(record)
    goals = [goal[:2] for goal in state.goals if goal is not None]
    points = np.concatenate([record.positions[round_number, :, :2], np.array(goals).reshape(-1, 2)])
    low, high = points.min(axis=0), points.max(axis=0)
    tall = (whole[3] - whole[2]) / (whole[1] - whole[0])
    wide = max(float(high[0] - low[0]), float(high[1] - low[1]) / tall)
    wide = max(wide, 4.0 * float(record.mission.mission["spacing"]))
    x, y = ((low + high) / 2).tolist()
    for room in ROOM:
        half, up = room * wide / 2, tall * room * wide / 2
        window = (x - half, x + half, y - up, y + up)
        if 2.0 * half > MOST_OF * (whole[1] - whole[0]):
            break
        if room == ROOM[-1] or _corner(points, window)[1] > 0.0:
            return window
    return None


def _corner(points: NDArray[np.float64], window: Box) -> tuple[tuple[float, float], float]:
    """The lower left corner of an inset where it is farthest from all points, and how far, in shares of the window."""
    left, right, bottom, top = window
    share = (points - [left, bottom]) / [right - left, top - bottom]
    corners = [(x, y) for y in (0.99 - INSET, 0.01) for x in (0.99 - INSET, 0.01)]
    room = np.abs(share[None] - (np.array(corners)[:, None] + INSET / 2)).max(axis=2).min(axis=1) - INSET / 2
    return corners[int(room.argmax())], float(room.max()) - MARGIN


def view(record: RunRecord, margin: float = 0.08) -> Box:
    """The arena, extended to every robot and goal outside, with a margin [units]."""
    low, high = (np.array(corner[:2], dtype=np.float64) for corner in record.mission.mission["arena"])
    goals = [goal[:2] for state in record.states for goal in state.goals if goal is not None]
    points = np.concatenate([record.positions[:, :, :2].reshape(-1, 2), np.array(goals).reshape(-1, 2)])
    low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
    pad = margin * float((high - low).max())
    return (float(low[0]) - pad, float(high[0]) + pad, float(low[1]) - pad, float(high[1]) + pad)
