"""Poses from ROS as the sensors of a swarm: the world process of bodies that something else moves.

The target of a body goes to ROS as a set-point. A body that lags behind it gets no further one, and a body that does
not follow at all counts as standing still.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from llm_flock import metrics
from llm_flock.arrays import Point
from llm_flock.errors import MessageError
from llm_flock.runtime import finite
from llm_flock_swarm._network.wire import Body, Command, WorldState
from llm_flock_swarm._network.world import SAME_POSITION
from llm_flock_swarm._ros2.wire import Attachment

FRESH_S = 0.25  # oldest pose in a reading of the sensors [s]; without a younger one of every robot there is none
LATE_S = 1.0  # poses that were sent longer ago, by both machines' clocks, are refused [s]
LOST_S = 1.0  # who is silent for this long may be followed by another source; a body that lags for it stays [s]
MAX_SPEED_FACTOR = 2.0  # poses farther apart than a body flies at this many times its largest speed are not of one body
MAX_BEHIND_PERIODS = 1.0  # control periods of flight that a body may be behind its end, and still gets a command


@dataclass(slots=True)
class _Track:
    """One body as its source tells it."""

    gid: bytes
    sequence: int
    heard_s: float  # when the last pose came
    stamp_s: float  # when it was sent
    position: Point
    end: Point
    followed_s: float  # when it was last where it was to be


class SensedBodies:
    """Where all bodies are, by their sources, and where each is to stop; `reach` is what a command covers [units]."""

    def __init__(
        self,
        n_robots: int,
        *,
        speed: float,
        reach: float,
        lag_s: float,
        clock: Callable[[], float],
        downwash: float = 1.0,
    ) -> None:
        self.late, self._downwash = 0, downwash
        self._speed = speed
        self._n, self._reach, self._lag_s, self._clock = n_robots, reach, lag_s, clock
        self._tracks: dict[int, _Track] = {}
        self._answered = [0] * n_robots

    @property
    def missing(self) -> list[int]:
        now = self._clock()
        tracks = self._tracks
        return [j for j in range(self._n) if j not in tracks or now - tracks[j].stamp_s > FRESH_S]

    def sense(self, robot: int, position: Point, attached: Attachment) -> None:
        """Take a pose [units]; a MessageError says why not. A body that was put elsewhere counts after `LOST_S`."""
        if not 0 <= robot < self._n:
            raise MessageError("unknown_robot", f"robot {robot}, not 0 to {self._n - 1}")
        now = self._clock()
        stamp_s = min(now, attached.stamp_ns / 1e9)
        if now - stamp_s > LATE_S:
            raise MessageError("late", f"robot {robot}: sent {now - stamp_s:.1f} s ago, if the clocks agree")
        track = self._tracks.get(robot)
        if track is None:
            self._tracks[robot] = _Track(attached.gid, attached.sequence, now, stamp_s, position, position, now)
            return
        lost = now - track.heard_s >= LOST_S
        if attached.gid != track.gid and not lost:
            raise MessageError("second_source", f"robot {robot}: two publishers tell where it is")
        if attached.gid == track.gid and attached.sequence <= track.sequence and not lost:
            raise MessageError("out_of_order", f"robot {robot}: number {attached.sequence} after {track.sequence}")
        moved = math.dist(position, track.position)
        if moved > self._reach + MAX_SPEED_FACTOR * self._speed * max(0.0, stamp_s - track.stamp_s) and not lost:
            raise MessageError("jump", f"robot {robot}: {moved:.3g} units at once")
        track.gid, track.sequence, track.heard_s = attached.gid, attached.sequence, now
        track.stamp_s, track.position = stamp_s, position
        if math.dist(position, track.end) <= MAX_BEHIND_PERIODS * self._reach:
            track.followed_s = now
        elif now - track.followed_s > LOST_S:
            track.end, track.followed_s = position, now

    def command(self, robot: int, order: Command) -> bool:
        """Take a command; returns whether it is obeyed, so that its target is the set-point."""
        track = self._tracks.get(robot)
        if track is None or order.number <= self._answered[robot]:
            return False
        self._answered[robot] = order.number
        usable = len(order.target) == len(track.end) and all(map(math.isfinite, order.target))
        if not usable or abs(self._clock() - order.stamp) > self._lag_s:
            self.late += 1
            return False
        if len(order.origin) != len(track.end) or math.dist(order.origin, track.end) > SAME_POSITION:
            return False
        if math.dist(track.position, track.end) > MAX_BEHIND_PERIODS * self._reach:
            return False
        if math.dist(order.target, track.end) > self._reach * (1 + SAME_POSITION):
            return False
        track.end = order.target
        return True

    def set_point(self, robot: int) -> Point | None:
        """The set-point of a body [units]; None before its first pose."""
        track = self._tracks.get(robot)
        return None if track is None else track.end

    def reading(self) -> WorldState | None:
        """The sensors' reading, as old as its oldest pose; None while a robot's pose is missing."""
        if self.missing:
            return None
        tracks = [self._tracks[robot] for robot in range(self._n)]
        return WorldState(
            stamp=min(track.stamp_s for track in tracks),
            closest=finite(metrics.min_separation([track.position for track in tracks], self._downwash)),
            bodies=tuple(
                Body(track.position, track.end, answered)
                for track, answered in zip(tracks, self._answered, strict=True)
            ),
            late=self.late,
        )
