"""The interface of a robot's driver: the state of a robot, and the commands of a flight.

All positions are [m; world frame of the localisation system, z up], all times [s]. A driver enforces its limits and
returns what it really sent. Every driver must pass the conformance checks of `llm_flock.testing._robots`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias, runtime_checkable

from llm_flock.errors import FlockError, InputError

Position: TypeAlias = tuple[float, float, float]

PEAK_SPEED = 2.1875
"""Highest over mean speed on a segment flown from rest to rest by a polynomial of degree 7 whose first three
derivatives vanish at both ends, s(u) = 35 u^4 - 84 u^5 + 70 u^6 - 20 u^7: its derivative at u = 1/2."""


class RobotError(FlockError):
    """The robot `name` cannot follow a command, or did not confirm it; `what` is the reason."""

    def __init__(self, name: str, what: str) -> None:
        self.name = name
        self.what = what
        super().__init__(f"{name}: {what}")


class TakenOver(RobotError):
    """A pilot or a failsafe flies the robot, which no longer obeys this program."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverCheck:
    """One check of a robot by its driver before a flight: the finding, and the requirement (empty if obvious)."""

    name: str
    passed: bool
    found: str
    asked: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Equipment:
    """A driver's knowledge of its robot from connecting; None if unknown."""

    controller: str | None = None  #: Name of the controller that makes the robot follow its set-point.
    estimator: str | None = None  #: Name of the estimator of its position.
    #: How far the robot is behind a moving set-point with that controller [s]: distance over speed.
    lag_s: float | None = None
    #: Above this speed of a set-point the controller falls behind without bound [m/s].
    max_speed_m_s: float | None = None
    complaints: tuple[str, ...] = ()  #: Reasons why it cannot fly until they are removed.
    unwatched: tuple[str, ...] = ()  #: Values that the robot does not report.


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotState:
    """The newest state of a robot that its driver knows."""

    position: Position  #: The estimate that the robot itself flies by [m].
    #: Arrival of that estimate, on this process's `time.monotonic`; stands still when estimates stop coming.
    stamp_s: float
    battery_v: float | None = None  #: [V]; None if the robot does not report it.
    link: float | None = None  #: Share of packets acknowledged, in [0, 1]; None if the link does not report it.
    link_lost: bool = False  #: The driver gave the link up and sends no more commands; stays True until `connect`.
    heard_s: float | None = None  #: Arrival of the last packet of any kind, on the same clock; None if unknown.
    armed: bool = False  #: Motors may turn.
    flying: bool = False  #: In the air, as far as the driver knows.
    settled: bool = True  #: The robot's estimator has converged.
    #: Why the robot no longer obeys: a pilot or a failsafe flies it, and the driver does not interfere. None as long as
    #: it obeys; stays set until `connect`.
    taken_over: str | None = None
    #: Why it cannot fly now, such as "locked: restart it"; None if it can, or if that is unknown.
    fault: str | None = None
    equipment: Equipment = Equipment()  #: The driver's knowledge from connecting.


@dataclass(frozen=True, slots=True, kw_only=True)
class Commanded:
    """A set-point as really sent, within the driver's limits [m], and the time from rest to rest [s]."""

    target: Position
    duration_s: float


class Robot(Protocol):
    """Drives one robot. Commands return when they are sent, not when they are flown.

    Every command raises `RobotError` if the robot is not connected, the link is lost, or the robot refuses.
    """

    @property
    def name(self) -> str:
        """The name in reports and errors."""
        ...

    async def connect(self, timeout_s: float) -> None:
        """Open the link and wait for the first estimate.

        Raises:
            RobotError: not done within `timeout_s`, even if the link's library waits longer.
        """
        ...

    def state(self) -> RobotState:
        """The newest state; never blocks, and still answers when the link is lost.

        Raises:
            RobotError: never connected.
        """
        ...

    async def arm(self) -> None:
        """Allow the motors to turn; returns once the robot reports that it is armed."""
        ...

    async def take_off(self, height_m: float, duration_s: float) -> Commanded:
        """Rise straight up to `height_m` (a z of the world frame) within `duration_s`."""
        ...

    async def go_to(self, target: Position, duration_s: float) -> Commanded:
        """Fly the straight segment from the last set-point to `target`, arriving at rest after `duration_s`.

        A target outside the driver's limits is brought nearer along the segment, never aside and never later: the
        shield's guarantee for the whole segment holds for any part of it.
        """
        ...

    async def hold(self) -> None:
        """Stop where the robot is, and stay there."""
        ...

    async def land(self, height_m: float, duration_s: float) -> None:
        """Land straight down to `height_m` within `duration_s`; the motors stop there."""
        ...

    async def stop_motors(self) -> bool:
        """Emergency stop: cut the motors now, in any state; the robot falls. Returns whether the robot confirmed it."""
        ...

    async def close(self) -> None:
        """Close the link. Sends nothing to the robot; harmless when called twice or never connected."""
        ...


@runtime_checkable
class SelfChecked(Protocol):
    """A robot whose driver has checks of its own for the preflight. Optional."""

    def checks(self) -> Sequence[DriverCheck]:
        """The checks, once it is connected."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionLimits:
    """Limits that a driver never exceeds."""

    low: Position = (-100.0, -100.0, -1.0)  #: Lowest corner of the geofence box [m].
    high: Position = (100.0, 100.0, 100.0)  #: Highest corner of it [m].
    max_speed_m_s: float = 2.0  #: Highest speed anywhere on a segment [m/s], the peak in its middle included.

    def __post_init__(self) -> None:
        if any(low > high for low, high in zip(self.low, self.high, strict=True)):
            raise InputError("low", self.low, f"a corner below {self.high}")
        if not self.max_speed_m_s > 0.0:
            raise InputError("max_speed_m_s", self.max_speed_m_s, "a positive number")

    def contains(self, position: Position) -> bool:
        """Whether the position is within the box."""
        return all(a <= x <= b for a, x, b in zip(self.low, position, self.high, strict=True))

    def clip(self, start: Position, target: Position, duration_s: float) -> Commanded:
        """The farthest point towards `target` within the box and the speed limit, in the same duration.

        From a start outside the box, the target is first clamped axis by axis: a return matters more than the line.

        Raises:
            InputError: a duration that is not positive.
        """
        if not duration_s > 0.0:
            raise InputError("duration_s", duration_s, "a positive time")
        if not self.contains(start):
            x, y, z = (min(max(x, a), b) for a, x, b in zip(self.low, target, self.high, strict=True))
            target = (x, y, z)
        step = tuple(b - a for a, b in zip(start, target, strict=True))
        length = sum(d * d for d in step) ** 0.5
        share = 1.0
        if length > 0.0:
            share = min(1.0, self.max_speed_m_s * duration_s / (PEAK_SPEED * length))
        for x, d, low, high in zip(start, step, self.low, self.high, strict=True):
            if x + d > high >= x:
                share = min(share, (high - x) / d)
            elif x + d < low <= x:
                share = min(share, (low - x) / d)
        if share >= 1.0:
            return Commanded(target=target, duration_s=duration_s)
        # Rounding may put the point just outside of the box.
        x, y, z = (start[k] + share * step[k] for k in range(3))
        if self.contains(start):
            x, y, z = (min(max(v, a), b) for a, v, b in zip(self.low, (x, y, z), self.high, strict=True))
        return Commanded(target=(x, y, z), duration_s=duration_s)


Quaternion: TypeAlias = tuple[float, float, float, float]
"""x, y, z and w, of length 1."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Position of a drone [m; world frame, z up], and its orientation if known."""

    position: Position
    quaternion: Quaternion | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseFrame:
    """Poses of drones by name, at one time of the sender's clock [s], which may start at any zero."""

    stamp_s: float
    poses: Mapping[str, Pose]


class PoseSource(Protocol):
    """Hands over frames while it is open. Open and close it once, in a running event loop."""

    @property
    def refused(self) -> Counter[str]:
        """Number of dropped inputs, by reason. They never end a source."""
        ...

    async def open(self, take: Callable[[PoseFrame], None]) -> None:
        """Call `take` with each frame from now on, in the event loop.

        Raises:
            InputError: the source cannot be opened.
        """
        ...

    async def close(self) -> None:
        """Stop handing over frames; harmless when called twice or never opened."""
        ...
