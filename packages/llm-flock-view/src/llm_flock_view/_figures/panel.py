"""A picture of the team at one moment, used in figures and animations."""

# Matplotlib's types leave **kwargs open.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle, Polygon
from matplotlib.patches import Rectangle as Frame
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from llm_flock import graph
from llm_flock.arrays import Points, flattened
from llm_flock.metrics import ROUNDING
from llm_flock.record import ASLEEP, DEAD, SILENT, RunRecord, State
from llm_flock_view._figures.crowd import spots, spread
from llm_flock_view._figures.labels import Outlines, Rectangle, beside, box_at, size_of
from llm_flock_view._figures.style import DANGER, FAINT, INK, NOT_BEGUN, PAPER, QUIET, PlanLook, plan_looks

Looks: TypeAlias = Sequence[PlanLook]

MAX_LABELLED = 30
MIN_LABELLED = 6.5
"""With more robots, or smaller discs [points], words are left out: there is no room for them."""

DISC_SHARE = 0.62  # diameter of a disc as a share of the spacing, so that neighbours in a formation stand apart
MAX_VIEW_SHARE = 0.7  # a team that takes more of the view than this share is not shown any closer

ROOM = (1.5, 2.1)
"""Widths of a close-up in widths of what it shows: the second where the first leaves no corner for the inset."""

RING = 1.4  # diameter of the ring of a goal, in discs
TAG, TALL = 0.75, 1.35  # room for a tag around its letters, and height of a word, in sizes of letters
MARGIN = 0.02  # between the inset and the middle of a disc, as a share of the panel's width
INSET = 0.24  # width and height of the inset that shows the whole view, as a share of the panel's

TIMES = "\u00d7"

Box = tuple[float, float, float, float]  # left, right, bottom, top [units]
ABOVE, SIDE = [0, 1], [0, 2]  # coordinates that are seen from above, and of space from the side


class Panel:
    """Draws moments of one record in a `window` [units]; robots and words fit its `width` [points].

    It shows two coordinates, by default those seen from above. Words have letters of at least `letters` [points]; discs
    have room for them.
    """

    def __init__(
        self,
        record: RunRecord,
        *,
        width: float = 165.0,
        window: Box | None = None,
        letters: float = 0.0,
        seen: list[int] = ABOVE,
    ) -> None:
        self.record = record
        self.seen = seen
        self.looks = plan_looks(record)
        self.window = view(record, seen=seen) if window is None else window
        n = record.positions.shape[1]
        self._scale = width / (self.window[1] - self.window[0])
        mission = record.mission.mission
        self._safe, self._downwash = float(mission["safe_distance"]), float(mission.get("downwash", 1.0))
        spacing = float(record.mission.mission["spacing"]) * self._scale
        self._disc = max(3.5, letters / 0.6, min(width / 17.0, DISC_SHARE * spacing))
        self._font = min(7.5, 0.6 * self._disc)
        self.labelled = n <= MAX_LABELLED and self._disc >= MIN_LABELLED
        self.mapped = False
        self._path = record.positions[:, :, seen]
        self._offsets: dict[int, tuple[float, float] | None] = {}

    def close_pairs(self, positions: NDArray[np.float64]) -> NDArray[np.intp]:
        """Pairs nearer than the safe distance in all dimensions, shape (k, 2)."""
        return np.argwhere(np.triu(graph.distances(flattened(positions, self._downwash)) < self._safe - ROUNDING, 1))

    def crowded(self, round_number: int) -> set[bool]:
        """Whether robots hide one another in a round: True for crowds with a pair too near, False for others."""
        if not self.labelled:
            return set()
        positions = self.record.positions[round_number]
        _, crowds = spread(positions[:, self.seen] * self._scale, self._disc / 2)
        return {bool(self.close_pairs(positions[one.members]).size) for one in crowds}

    def frame(self, axes: Axes) -> None:
        """Prepare the axes: this panel's window, the arena's walls, and the obstacles."""
        left, right, bottom, top = self.window
        axes.set_xlim(left, right)
        axes.set_ylim(bottom, top)
        axes.set_aspect("equal")
        axes.tick_params(length=2)
        # Obstacles of space, which are balls, are shown by their projection.
        mission = self.record.mission.mission
        (left, bottom), (right, top) = ([corner[k] for k in self.seen] for corner in mission["arena"])
        look: dict[str, Any] = {"edgecolor": FAINT, "linewidth": 0.8, "zorder": 0.5}
        axes.add_patch(Frame((left, bottom), right - left, top - bottom, facecolor="none", **look))
        for obstacle in mission.get("obstacles", ()):
            if obstacle.get("polygon") is not None:
                axes.add_patch(Polygon(obstacle["polygon"], closed=True, facecolor=FAINT, **look))
            else:
                x, y = (obstacle["center"][k] for k in self.seen)
                axes.add_patch(Circle((x, y), obstacle["radius"], facecolor=FAINT, **look))

    def inset(self, axes: Axes, round_number: int, whole: Box) -> None:
        """A small map of the whole view in the corner with the fewest robots; shows this window and every robot."""
        self.mapped = True
        # A window that reaches beyond the map ends at its edge.
        edge = 0.02 * (whole[1] - whole[0])
        left, bottom = max(self.window[0], whole[0] + edge), max(self.window[2], whole[2] + edge)
        right, top = min(self.window[1], whole[1] - edge), min(self.window[3], whole[3] - edge)
        at = self._path[round_number]
        small = axes.inset_axes((*_corner(at, self.window)[0], INSET, INSET), zorder=7)
        Panel(self.record, window=whole, seen=self.seen).frame(small)
        small.set_xticks([])
        small.set_yticks([])
        small.scatter(at[:, 0], at[:, 1], s=1.5, c=INK, linewidths=0, zorder=5)
        small.add_patch(Frame((left, bottom), right - left, top - bottom, fill=False, ec=INK, lw=0.7, zorder=6))

    def draw_team(self, axes: Axes, round_number: int, part: float = 1.0) -> None:
        """Draw the team after a `part` of a round, on framed axes whose place in the figure is final."""
        state = self.record.states[round_number]
        before = self.record.positions[max(0, round_number - 1)]
        positions = before + part * (self.record.positions[round_number] - before)
        places = positions[:, self.seen]
        looks = [
            NOT_BEGUN if phase == ASLEEP else self.looks[plan_id]
            for plan_id, phase in zip(state.plan_ids, state.phases, strict=True)
        ]
        self._links(axes, state, positions)
        self._trails(axes, round_number, places)
        self._goals(axes, state, looks)
        drawn, counts = self._spread(axes, places, positions)
        self._too_close(axes, positions, drawn)
        self._robots(axes, state, drawn, looks, counts)

    def _spread(
        self, axes: Axes, places: Points, positions: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], Sequence[Rectangle]]:
        """The places of discs [units], and the numbers of crowds [points], red where robots are too near in space."""
        if not self.labelled:
            return places, ()
        points = 72.0 / _dpi(axes)
        at, crowds = spread(points * np.asarray(axes.transData.transform(places)), self._disc / 2)
        drawn = np.asarray(axes.transData.inverted().transform(at / points))
        size = (2.0 * self._font, 1.4 * self._font)
        counts: list[Rectangle] = []
        for members, _, spot in spots(at, crowds, self._disc / 2, size, self._bounds(axes)):
            colour = DANGER if self.close_pairs(positions[members]).size else QUIET
            ties = np.stack([places[members], drawn[members]], axis=1)
            axes.add_collection(LineCollection(list(ties), colors=colour, linewidths=0.8, zorder=3.4))
            if spot is None:
                continue
            counts.append(box_at(spot, size))
            look: dict[str, Any] = {"boxstyle": "square,pad=0.1", "facecolor": colour, "edgecolor": "none"}
            self._word(
                axes, f"{len(members)}{TIMES}", spot, bbox=look, weight="bold", color=PAPER, scale=0.9, zorder=6.5
            )
        return drawn, counts

    def _too_close(self, axes: Axes, positions: NDArray[np.float64], drawn: NDArray[np.float64]) -> None:
        """Pairs nearer than the safe distance, in all dimensions, in red."""
        pairs = self.close_pairs(positions)
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
        axes.add_collection(
            LineCollection(list(positions[:, self.seen][pairs]), colors=FAINT, linewidths=0.8, zorder=2)
        )

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
        pairs = zip(state.goals, looks, strict=True)
        rings = [(goal, look.line, look.rim) for goal, look in pairs if goal is not None]
        if rings:
            points = np.array([goal for goal, *_ in rings])[:, self.seen]
            axes.scatter(
                points[:, 0],
                points[:, 1],
                s=(RING * self._disc) ** 2,
                facecolors="none",
                edgecolors=[colour for _, colour, _ in rings],
                linewidths=min(1.0, 0.15 * self._disc),
                linestyle=[rim for *_, rim in rings],
                zorder=3,
            )

    def _robots(self, axes: Axes, state: State, places: Points, looks: Looks, counts: Sequence[Rectangle]) -> None:
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

    def _words(self, axes: Axes, state: State, places: Points, looks: Looks, counts: Sequence[Rectangle]) -> None:
        """Letter of the plan on a tag in its colour, then the influence; beside a dead robot its number."""
        words = {robot: self._label(state, robot, looks[robot]) for robot in range(len(looks))}
        words = {robot: word for robot, word in words.items() if any(word)}
        points = 72.0 / _dpi(axes)
        order = [*words, *(robot for robot in range(len(places)) if robot not in words)]
        inset = [points * child.get_window_extent().get_points() for child in axes.child_axes]
        discs = points * np.asarray(axes.transData.transform(places[order]))
        tags = {robot: size_of(letters, self._font)[0] + TAG * self._font for robot, (letters, _) in words.items()}
        tags = {robot: wide if words[robot][0] else 0.0 for robot, wide in tags.items()}
        found = beside(
            discs,
            self._disc / 2 + 2.0,
            [(tags[robot] + size_of(text, self._font)[0], TALL * self._font) for robot, (_, text) in words.items()],
            self._bounds(axes),
            [*((low[0], high[0], low[1], high[1]) for low, high in inset), *counts],
            [self._offsets.get(robot) for robot in words],
            self._outlines(axes, state),
        )
        self._offsets = dict(zip(words, found, strict=True))
        for disc, (robot, (letters, text)), offset in zip(discs, words.items(), found, strict=False):
            if offset is None:
                continue
            middle, wide = disc + offset, size_of(text, self._font)[0]
            if letters:
                look = {"boxstyle": "square,pad=0.12", "facecolor": looks[robot].fill, "edgecolor": "none"}
                at = middle - [wide / 2, 0.0]
                self._word(axes, letters, at, bbox=look, weight="bold", color=looks[robot].ink, zorder=6)
            if text:
                halo = [withStroke(linewidth=0.25 * self._font, foreground=PAPER)]
                self._word(axes, text, middle + [tags[robot] / 2, 0.0], path_effects=halo, zorder=6)

    def _label(self, state: State, robot: int, look: PlanLook) -> tuple[str, str]:
        """Letters and number beside a robot: none before it has a plan."""
        if state.phases[robot] == DEAD:
            return "", str(robot)
        return (look.name, short(state.influence[robot])) if look.name else ("", "")

    def _word(
        self, axes: Axes, text: str, at: Sequence[float] | NDArray[np.float64], *, scale: float = 1.0, **look: Any
    ) -> None:
        place = (float(at[0]), float(at[1]))
        axes.annotate(
            text, place, xycoords="figure points", size=scale * self._font, ha="center", va="center_baseline", **look
        )  # fmt: skip

    def _bounds(self, axes: Axes) -> Rectangle:
        """The area for words [points]."""
        (left, bottom), (right, top) = 72.0 / _dpi(axes) * axes.transAxes.transform([(0, 0), (1, 1)])
        return float(left), float(right), float(bottom), float(top)

    def _outlines(self, axes: Axes, state: State) -> Outlines:
        """Lines that words cross only if there is no other room: rings, ways, walls and obstacles [points]."""
        points, mission = 72.0 / _dpi(axes), self.record.mission.mission

        def to_pixels(places: Any) -> NDArray[np.float64]:
            flat = np.asarray(places, dtype=np.float64)
            return points * np.asarray(axes.transData.transform(flat.reshape(-1, 2))).reshape(flat.shape)

        goals = to_pixels([[goal[k] for k in self.seen] for goal in state.goals if goal] or np.empty((0, 2)))
        rings = [np.column_stack([goals, np.full(len(goals), RING * self._disc / 2)])]
        (left, bottom), (right, top) = ([corner[k] for k in self.seen] for corner in mission["arena"])
        legs = np.stack([self._path[: state.round], self._path[1 : state.round + 1]], axis=2).reshape(-1, 2, 2)
        walls = _edges([(left, bottom), (right, bottom), (right, top), (left, top)])
        lines = [legs[(legs[:, 0] != legs[:, 1]).any(axis=1)], walls]
        for obstacle in mission.get("obstacles", ()):
            if obstacle.get("polygon") is not None:
                lines.append(_edges(obstacle["polygon"]))
                continue
            x, y = (obstacle["center"][k] for k in self.seen)
            middle, edge = to_pixels([[x, y], [x + obstacle["radius"], y]])
            rings.append(np.array([[*middle, np.linalg.norm(edge - middle)]]))
        return Outlines(np.concatenate(rings), to_pixels(np.concatenate(lines)))

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


def _edges(corners: Sequence[Sequence[float]]) -> NDArray[np.float64]:
    """The sides of a polygon, shape (k, 2, 2)."""
    rows = np.asarray(corners, dtype=np.float64)[:, :2]
    return np.stack([rows, np.roll(rows, -1, axis=0)], axis=1)


def _dpi(axes: Axes) -> float:
    figure = axes.figure
    assert figure is not None, "axes are part of a figure"
    return float(figure.dpi)


def short(share: float) -> str:
    """A number from 0 to 1 with two decimals in as few characters as possible: 0, .25, 1."""
    return f"{share:.0f}" if share in (0.0, 1.0) else f"{share:.2f}".removeprefix("0")


def close_up(record: RunRecord, round_number: int, seen: list[int] = ABOVE) -> Box | None:
    """A window on the team and its goals in one round; None where they fill most of the whole view anyway."""
    state, whole = record.states[round_number], view(record, seen=seen)
    goals = [[goal[k] for k in seen] for goal in state.goals if goal is not None]
    points = np.concatenate([record.positions[round_number][:, seen], np.array(goals).reshape(-1, 2)])
    low, high = points.min(axis=0), points.max(axis=0)
    tall = (whole[3] - whole[2]) / (whole[1] - whole[0])
    wide = max(float(high[0] - low[0]), float(high[1] - low[1]) / tall)
    wide = max(wide, 4.0 * float(record.mission.mission["spacing"]))
    x, y = ((low + high) / 2).tolist()
    for room in ROOM:
        half, up = room * wide / 2, tall * room * wide / 2
        window = (x - half, x + half, y - up, y + up)
        if 2.0 * half > MAX_VIEW_SHARE * (whole[1] - whole[0]):
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


def view(record: RunRecord, margin: float = 0.08, seen: list[int] = ABOVE) -> Box:
    """The arena, extended to every robot and goal outside, with a margin [units]."""
    low, high = (np.array(corner, dtype=np.float64)[seen] for corner in record.mission.mission["arena"])
    goals = [[goal[k] for k in seen] for state in record.states for goal in state.goals if goal is not None]
    points = np.concatenate([record.positions[:, :, seen].reshape(-1, 2), np.array(goals).reshape(-1, 2)])
    low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
    pad = margin * float((high - low).max())
    return (float(low[0]) - pad, float(high[0]) + pad, float(low[1]) - pad, float(high[1]) + pad)
