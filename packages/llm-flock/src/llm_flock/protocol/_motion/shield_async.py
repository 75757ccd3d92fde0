"""The shield for bodies that do not move in step; the proof is in docs/explanation/safe-motion.md.

If no room is left, a robot may still move away: as long as its direction makes an obtuse angle with every position that
the other may reach during the period, its own move does not bring the two nearer.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from llm_flock.arrays import Point, moved, separation
from llm_flock.protocol._motion.projection import TOLERANCE, HalfSpace, clip, line_of_sight, nearest_move


@dataclass(frozen=True, slots=True, kw_only=True)
class Sighting:
    """The last known position of another body [units; world frame], and its age."""

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
    downwash: float = 1.0,
    also: Sequence[HalfSpace] = (),
) -> Point:
    """The position nearest to `waypoint` that is safe at the end of the period; if there is none, the own position.

    Call at the start of every control period of `period_s`, with the newest sightings at hand, however old they are.
    Bodies keep the safe distance, with `downwash` as for `llm_flock.shield.project`, and fly at most with this speed
    [units/s]; believed positions are off by at most an error [units]. `also` holds further sides for a step of speed *
    period_s, from walls and obstacles.
    """
    longest = speed * period_s
    sides = list(also)
    for other in others:
        gap = separation(position, other.position, downwash)
        margin = speed * (other.age_s + period_s) + 2.0 * error
        room = gap - safe_distance - margin
        if room >= longest:
            continue
        if gap <= max(margin, TOLERANCE):
            return position  # the other may be in any direction
        # Without room: (y - position) . u <= 0 for every y that the other may reach.
        room = room if room >= 0.0 else -longest * margin / gap
        normal, share = line_of_sight(position, other.position, gap, downwash)
        sides.append(HalfSpace(normal, room / share))
    wish = clip(tuple(w - p for w, p in zip(waypoint, position, strict=True)), longest)
    move = nearest_move(wish, sides, longest)
    return position if move is None else moved(position, move)
