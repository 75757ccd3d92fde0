"""Buffered Voronoi shield: the nearest safe waypoint to the one that was asked for.

Zhou, Wang, Bandyopadhyay, Schwager: Fast, on-line collision avoidance for dynamic vehicles using buffered Voronoi
cells (IEEE RA-L 2017). Each robot stays on its own side of the bisector to every neighbour, shrunk by half the safe
distance. If all do so from one snapshot and move along straight segments in step, no pair is ever nearer than the
safe distance, on the way either: along the line of sight each gives up at most half of the room between them, so the
distance along it never falls below `safe_distance`. Bodies that do not move in step:
`llm_flock.protocol.motion.shield_async`.

A pair that is too near already has sides that ask for a way back. As long as each goes part of it, however little, and
not forward, the pair's distance never falls, so starts that violate the limit heal.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

from llm_flock.arrays import Point
from llm_flock.protocol.motion.projection import TOLERANCE, HalfSpace, relaxed_move

STEP_SHARES = (1.0, 0.5, 0.25, 0.125)
"""Lengths of step that are tried where positions are uncertain, as shares of `max_step`."""

APART = 1e-6
"""How far apart bodies on one spot are taken to be [units]; only their direction matters."""

Sides = Callable[[float], Sequence[HalfSpace]]
"""Further sides of a cell, for a given longest step [units]: walls and obstacles."""


def separation_half_spaces(
    position: Point,
    neighbors: Iterable[Point],
    *,
    safe_distance: float,
    max_step: float,
    noise_bound: float = 0.0,
) -> list[HalfSpace]:
    """The sides of the buffered Voronoi cell that can matter within one step, as limits on the displacement.

    With positions known to within `noise_bound` e [units], each side moves inwards by e for the distance and by
    4 e max_step / d for the direction: two estimated positions turn the line of sight by at most 4 e / d, and a
    step of that length along a line so turned is off by that much.
    """
    sides: list[HalfSpace] = []
    for other in neighbors:
        gap = math.dist(position, other)
        if gap < TOLERANCE:
            continue  # no line of sight: see `told_apart`
        margin = noise_bound * (1.0 + 4.0 * max_step / gap)
        room = (gap - safe_distance) / 2.0 - margin
        if room < max_step:
            normal = tuple((b - a) / gap for a, b in zip(position, other, strict=True))
            sides.append(HalfSpace(normal, max(-max_step, room), gap < safe_distance - 2.0 * noise_bound))
    return sides


def told_apart(robot: int, position: Point, sensed: Mapping[int, Point]) -> dict[int, Point]:
    """Sensed positions, where bodies on the robot's own spot are taken to stand around it, in the order of ids.

    All that are on one spot think up the same tiny regular polygon with the lowest id at angle 0, so each has a
    direction of its own to leave in, and any two agree on the line between them.
    """
    here = sorted([robot, *(j for j, x in sensed.items() if math.dist(x, position) < TOLERANCE)])
    if len(here) == 1:
        return dict(sensed)
    angles = {j: 2.0 * math.pi * k / len(here) for k, j in enumerate(here)}
    own = angles.pop(robot)
    apart = dict(sensed)
    for j, angle in angles.items():
        x, y = math.cos(angle) - math.cos(own), math.sin(angle) - math.sin(own)
        apart[j] = (position[0] + APART * x, position[1] + APART * y, *position[2:])
    return apart


def project(
    position: Point,
    waypoint: Point,
    neighbors: Iterable[Point],
    *,
    safe_distance: float,
    max_step: float,
    noise_bound: float = 0.0,
    also: Sides | None = None,
) -> Point:
    """The point of the robot's buffered Voronoi cell, within `max_step`, that is nearest to `waypoint`.

    Args:
        position: where the robot believes it is, d coordinates [units].
        waypoint: where it wants to be.
        neighbors: believed positions of all robots within sensing range.
        safe_distance: smallest distance allowed between two robots [units].
        max_step: longest move allowed [units].
        noise_bound: largest error of each believed position [units].
        also: further sides of the cell for a longest step, from walls and obstacles.

    Returns:
        The waypoint to fly to; `position` itself where the cell is empty (then standing still is safest).
    """
    others = tuple(neighbors)

    def within(longest: float) -> Point:
        sides = separation_half_spaces(
            position, others, safe_distance=safe_distance, max_step=longest, noise_bound=noise_bound
        )
        if also is not None:
            sides.extend(also(longest))
        return _within(position, waypoint, sides, longest)

    if noise_bound == 0.0:
        return within(max_step)
    # The margin for the direction grows with the step: a shorter step may lead farther through a narrow gap.
    return min((within(max_step * share) for share in STEP_SHARES), key=lambda target: math.dist(target, waypoint))


def _within(position: Point, waypoint: Point, sides: Sequence[HalfSpace], longest: float) -> Point:
    wish = tuple(w - p for w, p in zip(waypoint, position, strict=True))
    move = relaxed_move(wish, sides, longest)
    # The waypoint comes back as it was given, not as position + (waypoint - position).
    return waypoint if move is wish else tuple(p + u for p, u in zip(position, move, strict=True))
