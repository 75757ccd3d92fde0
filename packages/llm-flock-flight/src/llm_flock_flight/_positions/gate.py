"""Lets through the poses that a drone can have flown, and counts the others with the drone's name. Reads no clock.

A motion capture may deliver late, lose a drone, repeat its last pose without end, or take one drone for another.
A wrong pose makes a drone fly away, so doubtful poses are not sent: without poses for a while, the flight lands.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from llm_flock.robots import Pose, PoseFrame, Position
from llm_flock_flight._flight.sections import PositionsConfig

STEPS = 10  # poses of a drone's last `lost_s` that are remembered

LATE, OUT_OF_ORDER, JUMP, SWAP, FROZEN, UNKNOWN = "late", "out_of_order", "jump", "swap", "frozen", "unknown_name"
"""Reasons to refuse a pose."""


@dataclass(slots=True)
class _Track:
    """The last accepted pose of a drone."""

    position: Position
    stamp_s: float
    came_s: float
    past: deque[tuple[float, Position]]
    """Accepted ones of the last `lost_s` with their arrivals, the oldest first, and one before them."""


class PoseGate:
    """Judges frames one by one; `doubts` has the reason why the newest pose of a drone was refused, by name.

    A drone flies no faster than `speed_m_s`. After `pose_lost_s` without an accepted pose, one on the ground may be
    anywhere. Set `flying` from the first take-off on: then a track is never given up, so that a drone which was lost
    cannot come back as another one. In `refused`, an empty name stands for poses of no drone.
    """

    def __init__(self, names: Iterable[str], limits: PositionsConfig, speed_m_s: float) -> None:
        self.flying = False
        self.refused: Counter[tuple[str, str]] = Counter()
        self.on_refusal: Callable[[str, str], None] = lambda name, reason: None
        self.doubts: dict[str, str] = {}
        self._names = frozenset(names)
        self._limits, self._speed_m_s = limits, speed_m_s
        self._tracks: dict[str, _Track] = {}
        self._repeated: dict[str, tuple[Pose, float]] = {}  # the last pose that came, and when it first did
        self._delay: tuple[float, float] | None = None  # smallest arrival less stamp, and when it was seen

    def take(self, frame: PoseFrame, now: float) -> dict[str, Pose]:
        """The accepted poses of a frame that arrived at `now`, by name."""
        if not self.flying:
            gone = [n for n, track in self._tracks.items() if now - track.came_s > self._limits.pose_lost_s]
            for name in gone:
                del self._tracks[name]
        late = self._late_s(frame.stamp_s, now) > self._limits.pose_late_s
        before = {name: track.position for name, track in self._tracks.items()}
        accepted: dict[str, Pose] = {}
        for name, pose in frame.poses.items():
            if name not in self._names:
                self._refuse("", UNKNOWN)
            elif self._frozen(name, pose, now):
                self._refuse(name, FROZEN)
            elif (why := LATE if late else self._fault(name, pose.position, frame.stamp_s, now, before)) is not None:
                self._refuse(name, why)
            else:
                accepted[name] = pose
        for name, pose in accepted.items():
            past = self._tracks[name].past if name in self._tracks else deque[tuple[float, Position]]()
            while len(past) > 1 and past[1][0] <= now - self._limits.pose_lost_s:
                past.popleft()
            if not past or now - past[-1][0] >= self._limits.pose_lost_s / STEPS:
                past.append((now, pose.position))
            self.doubts.pop(name, None)
            self._tracks[name] = _Track(pose.position, frame.stamp_s, now, past)
        return accepted

    def _fault(self, name: str, at: Position, stamp_s: float, now: float, before: dict[str, Position]) -> str | None:
        track, limits = self._tracks.get(name), self._limits
        if track is None:
            return None
        if stamp_s <= track.stamp_s:
            return OUT_OF_ORDER
        moved = math.dist(at, track.position)
        if any(math.dist(at, other) < moved for who, other in before.items() if who != name):
            return SWAP
        if moved > limits.pose_jump_m + self._speed_m_s * min(now - track.came_s, limits.pose_lost_s):
            return JUMP
        came_s, place = track.past[0]  # many small steps make a jump as well
        if math.dist(at, place) > limits.pose_jump_m + self._speed_m_s * (now - came_s):
            return JUMP
        return None

    def _frozen(self, name: str, pose: Pose, now: float) -> bool:
        """Whether a drone's pose has had the very same numbers for too long."""
        last, since_s = self._repeated.get(name, (None, now))
        if last != pose:
            since_s = now
        self._repeated[name] = pose, since_s
        return 0.0 < self._limits.pose_frozen_s < now - since_s

    def _refuse(self, name: str, why: str) -> None:
        self.refused[name, why] += 1
        if name:
            self.doubts[name] = why
        if self.refused[name, why] == 1:
            self.on_refusal(name, why)

    def _late_s(self, stamp_s: float, now: float) -> float:
        """How much longer this frame was on its way than the fastest one [s]. The clocks need not agree."""
        delay = now - stamp_s
        if self._delay is not None:
            least, seen_s = self._delay
            restarted = not self.flying and delay - least > 2 * self._limits.pose_lost_s and not self._tracks
            if not restarted:
                least += 1e-3 * (now - seen_s)  # the clocks drift
                self._delay = min(least, delay), now
                return delay - self._delay[0]
        self._delay = delay, now
        return 0.0
