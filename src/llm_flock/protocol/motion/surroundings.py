"""Arena walls and obstacles as sides of a robot's cell.

A robot's centre stays inside the arena and half the safe distance (the radius of a body) away from obstacles. Each
side is the plane through the nearest point of a convex set, moved towards the robot by the buffer. The set lies
entirely beyond that plane, so the whole straight path to any point of the cell is clear, not only its end.
"""

from __future__ import annotations

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.protocol.motion.projection import HalfSpace


def static_half_spaces(
    position: Point, mission: Mission, *, max_step: float, noise_bound: float = 0.0
) -> list[HalfSpace]:
    """The walls and obstacles within one step, as sides of the robot's cell. Call for `also` of the projections.

    From outside the arena or inside an obstacle they lead back, by at most a full step per round. With the position
    known to within `noise_bound` e [units], a wall moves inwards by e, for its direction is known. The direction to the
    nearest point of an obstacle at distance d turns by at most 2 e / d, so its side moves by e and by 2 e max_step / d.
    """
    sides: list[HalfSpace] = []
    low, high = mission.arena
    for axis, x in enumerate(position):
        for sign, room in ((-1.0, x - low[axis]), (1.0, high[axis] - x)):
            if room - noise_bound < max_step:
                normal = tuple(sign if k == axis else 0.0 for k in range(len(position)))
                sides.append(HalfSpace(normal, max(-max_step, room - noise_bound), room < -noise_bound))
    buffer = mission.body_radius
    for obstacle in mission.obstacles:
        for nearest in obstacle.nearest(position):
            margin = noise_bound * (1.0 + 2.0 * max_step / max(nearest.distance, buffer))
            room = nearest.distance - buffer - margin
            if room < max_step:
                normal = tuple(-x for x in nearest.outward)
                violated = nearest.distance - buffer < -noise_bound
                sides.append(HalfSpace(normal, max(-max_step, room), violated))
    return sides
