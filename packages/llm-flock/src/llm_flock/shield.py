"""Buffered Voronoi shield: the safe waypoint nearest to the planner's.

Zhou, Wang, Bandyopadhyay, Schwager: Fast, on-line collision avoidance for dynamic vehicles using buffered Voronoi
cells (IEEE RA-L 2017). Each robot stays on its own side of the bisector with every neighbour, shrunk by half the safe
distance. If all robots do so from one snapshot and move in step along straight segments, no pair is ever nearer than
the safe distance, not even on the way: along the line of sight each robot uses at most half of the room between them,
so their distance along it never falls below `safe_distance`. Distances of robots are those of `arrays.flattened`, in
which a step is never longer than it is. For bodies that do not move in step, use
`llm_flock.protocol._motion.shield_async`.

For a pair that is already too close, the sides ask both robots to move back. As long as each moves back at least a
little, and not forward, their distance never falls, so starts that violate the limit recover.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

from llm_flock.arrays import Point, moved, separation
from llm_flock.protocol._motion.projection import TOLERANCE, HalfSpace, line_of_sight, relaxed_move

Sides = Callable[[float], Sequence[HalfSpace]]
"""Further sides of a cell for a given longest step [units]: walls and obstacles."""


def separation_half_spaces(
    position: Point,
    neighbors: Iterable[Point],
    *,
    safe_distance: float,
    max_step: float,
    noise_bound: float = 0.0,
    downwash: float = 1.0,
) -> list[HalfSpace]:
    """The sides of the buffered Voronoi cell within one step, as limits on the displacement.

    With positions known to within `noise_bound` e [units], each side moves inwards by e for the distance d and by
    4 e max_step / d for the direction: two estimated positions turn the line of sight by at most 4 e / d, so the end
    of a step of length max_step is off by at most 4 e max_step / d. Arguments as for `project`.
    """
    sides: list[HalfSpace] = []
    for other in neighbors:
        gap = separation(position, other, downwash)
        if gap < TOLERANCE:
            continue  # no line of sight: see `spread_coincident`
        margin = noise_bound * (1.0 + 4.0 * max_step / gap)
        room = (gap - safe_distance) / 2.0 - margin
        if room < max_step:
            normal, share = line_of_sight(position, other, gap, downwash)
            sides.append(HalfSpace(normal, max(-max_step, room / share), gap < safe_distance - 2.0 * noise_bound))
    return sides


def spread_coincident(robot: int, position: Point, sensed: Mapping[int, Point]) -> dict[int, Point]:
    """Sensed positions, with bodies at the robot's own position spread around it. Call before separating a crowd.

    All robots at one position assume the same tiny regular polygon, with ids in ascending order from angle 0. So each
    has a different direction in which to leave, and any two agree on the line between them.
    """
    here = sorted([robot, *(j for j, x in sensed.items() if math.dist(x, position) < TOLERANCE)])
    if len(here) == 1:
        return dict(sensed)
    angles = {j: 2.0 * math.pi * k / len(here) for k, j in enumerate(here)}
    own, radius = angles.pop(robot), 1e-6  # only the directions matter
    apart = dict(sensed)
    for j, angle in angles.items():
        x, y = math.cos(angle) - math.cos(own), math.sin(angle) - math.sin(own)
        apart[j] = (position[0] + radius * x, position[1] + radius * y, *position[2:])
    return apart


def project(
    position: Point,
    waypoint: Point,
    neighbors: Iterable[Point],
    *,
    safe_distance: float,
    max_step: float,
    noise_bound: float = 0.0,
    downwash: float = 1.0,
    also: Sides | None = None,
) -> Point:
    """The point of the robot's buffered Voronoi cell, within `max_step`, nearest to `waypoint`.

    Call once in each round, in every robot, with positions of one moment.

    Args:
        position: the robot's believed position, d coordinates [units].
        waypoint: the wanted position [units].
        neighbors: believed positions of all robots within sensing range [units].
        safe_distance: smallest allowed distance between two robots [units].
        max_step: longest allowed move [units].
        noise_bound: largest error of each believed position [units].
        downwash: how many times the safe distance applies to robots above each other, at most `mission.MAX_DOWNWASH`.
        also: further sides of the cell for a given longest step, from walls and obstacles.

    Returns:
        The waypoint to fly to; `position` itself if the cell is empty (then standing still is safest).
    """
    others = tuple(neighbors)

    def within(longest: float) -> Point:
        sides = separation_half_spaces(
            position,
            others,
            safe_distance=safe_distance,
            max_step=longest,
            noise_bound=noise_bound,
            downwash=downwash,
        )
        if also is not None:
            sides.extend(also(longest))
        wish = tuple(w - p for w, p in zip(waypoint, position, strict=True))
        move = relaxed_move(wish, sides, longest)
        # An unchanged waypoint is returned as given, without the rounding of position + (waypoint - position).
        return waypoint if move is wish else moved(position, move)

    if noise_bound == 0.0:
        return within(max_step)
    further = () if also is None else also(max_step)
    back = [side for side in further if side.violated]

    def cost(target: Point) -> tuple[float, float]:
        """How much the step lacks to lead back from where it has to, and its distance from the waypoint."""
        lacks = [sum(n * (b - a) for n, a, b in zip(x.normal, position, target, strict=True)) - x.room for x in back]
        return max(TOLERANCE, *lacks, 0.0), math.dist(target, waypoint)

    # The margin for the direction grows with the step, so a shorter step may lead farther through a narrow gap.
    return min((within(max_step * share) for share in (1.0, 0.5, 0.25, 0.125)), key=cost)
