"""The shield for bodies that do not move in step: every control period the target is projected anew.

The proof of the lockstep form needs one snapshot and one beat. Here a robot relies on nothing that others do but their
largest speed v. A sighting of age a, of a body that may be anywhere within m = v (a + T) of it by the end of the
coming period T, leaves d - safe_distance - m of the way towards it: whoever flies no farther than that, and for one
period only, ends the period at the safe distance at least, whatever the other does. With positions known to within e,
the line of sight is off by 2 e, which is added to m. So any two schedules, and any delays that the ages tell, are safe.

Where less than nothing is left, a robot may still move away: as long as its direction makes an obtuse angle with every
place where the other may be during the period, its own move brings the two no nearer. Two that do this at once both
add to the distance.

A body that has announced a segment and flies it to its end is sighted with that segment: others keep clear of the
whole of it, and add m only for what the body may fly after its end.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from llm_flock.arrays import Point
from llm_flock.obstacles.polygons import nearest_on_segment
from llm_flock.protocol.motion.projection import TOLERANCE, HalfSpace, clip, nearest_move


@dataclass(frozen=True, slots=True, kw_only=True)
class Sighting:
    """What is known of another body.

    Attributes:
        position: where it was [units; world frame].
        age_s: how long ago that was [s].
        committed: the end of the segment that it has announced and was flying, if it has [units; world frame].
    """

    position: Point
    age_s: float
    committed: Point | None = None


def async_half_spaces(
    position: Point,
    others: Iterable[Sighting],
    *,
    safe_distance: float,
    speed: float,
    period_s: float,
    error: float = 0.0,
) -> list[HalfSpace] | None:
    """The sides of the cell for one control period; None where only standing still is safe.

    Args:
        position: where the robot believes it is [units; world frame].
        others: everybody that may come near.
        safe_distance: smallest distance allowed between two bodies [units].
        speed: largest speed of any body [units/s].
        period_s: time until the next projection [s].
        error: largest error of any believed position [units].
    """
    longest = speed * period_s
    sides: list[HalfSpace] = []
    for other in others:
        end = other.position if other.committed is None else other.committed
        there = nearest_on_segment(position, other.position, end)
        gap = math.dist(position, there)
        flown = max(0.0, speed * (other.age_s + period_s) - math.dist(other.position, end))
        margin = flown + 2.0 * error
        room = gap - safe_distance - margin
        if room >= longest:
            continue
        if gap <= max(margin, TOLERANCE):
            return None  # it may be on any side by now
        if room >= 0.0:
            sides.append(_towards(position, there, room))
            continue
        # (y - position) . u <= 0 for every y within the margin of the segment, if it holds around both its ends.
        for y in dict.fromkeys((other.position, end)):
            sides.append(_towards(position, y, -longest * margin / math.dist(position, y)))
    return sides


def _towards(position: Point, other: Point, room: float) -> HalfSpace:
    gap = math.dist(position, other)
    return HalfSpace(tuple((b - a) / gap for a, b in zip(position, other, strict=True)), room)


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
    """The place nearest to `waypoint` that is safe to fly to, at no more than `speed`, until the period ends.

    Arguments as in `async_half_spaces`; `also` holds further sides for a step of speed * period_s, from walls and
    obstacles. The caller projects again when the period is over, with fresh sightings or with older ones.

    Returns:
        Where to be at the end of the period; `position` itself where standing still is the only safe thing.
    """
    sides = async_half_spaces(
        position, others, safe_distance=safe_distance, speed=speed, period_s=period_s, error=error
    )
    if sides is None:
        return position
    wish = clip(tuple(w - p for w, p in zip(waypoint, position, strict=True)), speed * period_s)
    move = nearest_move(wish, [*sides, *also], speed * period_s)
    return position if move is None else tuple(p + u for p, u in zip(position, move, strict=True))
