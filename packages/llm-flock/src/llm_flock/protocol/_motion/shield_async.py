"""The shield for bodies that do not move in step: each projects its waypoint again in every control period.

The proof of the lockstep form needs one snapshot and synchronous moves. Here a robot relies on nothing but the largest
speed v of the others. By the end of the coming period T, a body sighted a seconds ago is within m = v (a + T) of its
sighting. A robot at distance d that flies at most d - safe_distance - m towards the sighting, for one period only,
ends the period at least at the safe distance, whatever the other body does. With positions known to within e, the
line of sight is off by 2 e, which is added to m. So all schedules, and all delays that the ages account for, are safe.

If that room is negative, a robot may still move away: as long as its direction makes an obtuse angle with every
position that the other may reach during the period, its own move does not bring the two nearer. If both do so, both
add to the distance.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from llm_flock.arrays import Point, moved
from llm_flock.protocol._motion.projection import TOLERANCE, HalfSpace, clip, nearest_move


@dataclass(frozen=True, slots=True, kw_only=True)
class Sighting:
    """The last known position of another body [units; world frame], and how old this is."""

    position: Point
    age_s: float


def project_async(
    position: Point,
    waypoint: Point,
    others: Iterable[Sighting],
    *,
    safe_distance: float,
    speed: float,
    period_s: float,
    error: float = 0.0,
    also: Sequence[HalfSpace] = (),
) -> Point:
    """The position nearest to `waypoint` that is safe at the end of the period; the own one if nothing else is.

    Call at the start of every control period of `period_s`, with the newest sightings at hand, however old they are.
    Bodies keep the safe distance, and fly at most with this speed [units/s]; believed positions are off by at most an
    error [units]. `also` holds further sides for a step of speed * period_s, from walls and obstacles.
    """
    longest = speed * period_s
    sides = list(also)
    for other in others:
        gap = math.dist(position, other.position)
        margin = speed * (other.age_s + period_s) + 2.0 * error
        room = gap - safe_distance - margin
        if room >= longest:
            continue
        if gap <= max(margin, TOLERANCE):
            return position  # it may be in any direction by now
        # Without room: (y - position) . u <= 0 for every y that the other may reach.
        room = room if room >= 0.0 else -longest * margin / gap
        sides.append(HalfSpace(tuple((b - a) / gap for a, b in zip(position, other.position, strict=True)), room))
    wish = clip(tuple(w - p for w, p in zip(waypoint, position, strict=True)), longest)
    move = nearest_move(wish, sides, longest)
    return position if move is None else moved(position, move)
