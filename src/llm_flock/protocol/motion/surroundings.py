"""Arena walls and obstacles as sides of a robot's cell.

A robot's centre stays inside the arena and half the safe distance (the radius of a body) away from obstacles. Each
side is the plane through the nearest point of a convex set, moved towards the robot by the buffer. The set lies
entirely beyond that plane, so the whole straight path to any point of the cell is clear, not only its end.
"""

from __future__ import annotations

from collections.abc import Iterable

from llm_flock.arrays import Point
from llm_flock.obstacles import Obstacle
from llm_flock.protocol.motion.limits import Limits
from llm_flock.protocol.motion.projection import HalfSpace


def wall_half_spaces(
    position: Point, arena: tuple[Point, Point], *, max_step: float, noise_bound: float = 0.0
) -> list[HalfSpace]:
    """The arena's walls within one step. From outside they lead back, by at most a full step per round.

    The direction of a wall is known, so an error of up to `noise_bound` e [units] in the position moves it inwards by
    e only.
    """
    sides: list[HalfSpace] = []
    low, high = arena
    for axis, x in enumerate(position):
        for sign, room in ((-1.0, x - low[axis]), (1.0, high[axis] - x)):
            if room - noise_bound < max_step:
                normal = tuple(sign if k == axis else 0.0 for k in range(len(position)))
                sides.append(HalfSpace(normal, max(-max_step, room - noise_bound), room < -noise_bound))
    return sides


def obstacle_half_spaces(
    position: Point, obstacles: Iterable[Obstacle], *, buffer: float, max_step: float, noise_bound: float = 0.0
) -> list[HalfSpace]:
    """The obstacles within one step of their buffer. From inside they lead out.

    With the position known to within `noise_bound` e [units], a side moves inwards by e for the distance d and by
    2 e max_step / d for the direction: the direction to the nearest point of a convex set turns by at most 2 e / d.
    """
    sides: list[HalfSpace] = []
    for obstacle in obstacles:
        for nearest in obstacle.nearest(position):
            margin = noise_bound * (1.0 + 2.0 * max_step / max(nearest.distance, buffer))
            room = nearest.distance - buffer - margin
            if room < max_step:
                normal = tuple(-x for x in nearest.outward)
                violated = nearest.distance - buffer < -noise_bound
                sides.append(HalfSpace(normal, max(-max_step, room), violated))
    return sides


def static_half_spaces(
    position: Point, limits: Limits, *, max_step: float, noise_bound: float = 0.0
) -> list[HalfSpace]:
    """The walls and obstacles within one step, as sides of the robot's cell. Call for `also` of the projections."""
    walls = wall_half_spaces(position, limits.arena, max_step=max_step, noise_bound=noise_bound)
    if not limits.obstacles:
        return walls
    return walls + obstacle_half_spaces(
        position, limits.obstacles, buffer=limits.body_radius, max_step=max_step, noise_bound=noise_bound
    )
