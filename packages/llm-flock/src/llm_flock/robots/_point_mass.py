"""A simulated drone that follows its set-point, exactly or with a controller, and can fail. Sans-IO."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, Protocol, TypeAlias

from llm_flock.robots._base import Position
from llm_flock.robots._segment import Segment

Mode: TypeAlias = Literal["idle", "flying", "landing"]

GRAVITY = 9.81  # [m/s^2]
FALL_HEIGHT = 0.1  # a landing that ends below this height ends on the ground [m]
REFUSED = 1  # the firmware's answer to a command that is impossible now
BUSY = 16  # the firmware's answer while motors may not run (EBUSY)


class BodyController(Protocol):
    """Flies a body at `place` [m] after its set-point."""

    place: Position

    def fly(self, now: float, set_point: Callable[[float], Position], floor_m: float) -> None:
        """Fly on until now, after the set-point [m] at each time; the floor stops a fall."""
        ...

    def shift(self, offset: Position) -> None:
        """Shift the body's estimate of its place [m]."""
        ...


MakeController: TypeAlias = Callable[[Position, float], BodyController]
"""Makes the controller of a body from its place [m], where it is at rest, and the time [s]."""


@dataclass(slots=True, kw_only=True)
class PointMass:
    """One body, at `home` before take-off [m]. `estimate` is the robot's own, `position` the true one.

    With `auto_arm` motors may turn at once, as in a Crazyflie 2.1 as shipped. `controlled` makes the controller that
    follows the set-point; without one, the body follows exactly. Change it with `follow`.
    """

    home: Position
    ground_m: float = 0.0
    auto_arm: bool = False
    battery_v: float = 4.0
    controlled: MakeController | None = None
    mode: Mode = field(default="idle", init=False)
    armed: bool = field(default=False, init=False)
    locked: bool = field(default=False, init=False)
    _segment: Segment | None = field(default=None, init=False)
    _rest: Position = field(init=False)
    _fell: float | None = field(default=None, init=False)
    _offset: Position = field(default=(0.0, 0.0, 0.0), init=False)
    _error: Position = field(default=(0.0, 0.0, 0.0), init=False)
    _error_at: float = field(default=0.0, init=False)
    _stalled: tuple[float, Position] | None = field(default=None, init=False)
    _controller: BodyController | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self._rest = self.home
        self.armed = self.auto_arm

    @property
    def flying(self) -> bool:
        return self.mode != "idle"

    def advance(self, now: float) -> None:
        """Let time pass: a landing ends."""
        down = math.inf
        if self.mode == "landing" and self._segment is not None:
            down = self._segment.began_s + self._segment.duration_s
        self._catch_up(min(now, down))
        if now >= down:
            self._motors_off(down)
        if self._fell is not None and self._height(now) <= self.ground_m:
            self._rest = (self._rest[0], self._rest[1], self.ground_m)
            self._fell = None

    def _catch_up(self, now: float) -> None:
        """Let the controller work until now."""
        segment = self._segment
        if self._controller is not None and segment is not None:
            self._controller.fly(now, lambda at: segment.at(at)[0], self.ground_m + self._offset[2])

    def follow(self, controlled: MakeController | None, now: float) -> None:
        """Change the controller, also in flight."""
        here = self.position(now)
        self.controlled, self._controller = controlled, None
        if self._segment is not None:
            self._take_control(here, now)
            if controlled is None:
                self._set_error(here, now)

    def _take_control(self, here: Position, now: float) -> None:
        """Start the controller, if there is one, at rest at the robot's estimate of this position."""
        if self.controlled is not None:
            x, y, z = (p + o for p, o in zip(here, self._offset, strict=True))
            self._controller = self.controlled((x, y, z), now)

    def position(self, now: float) -> Position:
        """True position of the body [m]."""
        self.advance(now)
        if self._segment is None:
            return (self._rest[0], self._rest[1], self._height(now))
        if self._controller is not None:
            x, y, z = (b - o for b, o in zip(self._controller.place, self._offset, strict=True))
            return (x, y, max(z, self.ground_m))
        believed, _, _ = self._segment.at(now)
        left = math.exp(-4.0 * max(0.0, now - self._error_at))  # the error is flown off
        x, y, z = (b - o + left * e for b, o, e in zip(believed, self._offset, self._error, strict=True))
        return (x, y, max(z, self.ground_m))

    def estimate(self, now: float) -> Position:
        """The position that the robot estimates [m]."""
        if self._stalled is not None:
            return self._stalled[1]
        x, y, z = (p + o for p, o in zip(self.position(now), self._offset, strict=True))
        return (x, y, z)

    def variance(self, now: float) -> float:
        """Variance of the estimate on one axis [m^2]; grows once the localisation has failed."""
        return 1e-5 + (0.0 if self._stalled is None else 0.05 * (now - self._stalled[0]))

    def _height(self, now: float) -> float:
        if self._fell is None:
            return self._rest[2]
        return max(self.ground_m, self._rest[2] - GRAVITY * (now - self._fell) ** 2 / 2.0)

    def arm(self, wanted: bool) -> bool:
        """Arm or disarm; returns whether that succeeded."""
        if self.locked or (wanted and self.flying):
            return not wanted
        self.armed = wanted
        return True

    def take_off(self, height_m: float, duration_s: float, now: float) -> int:
        """Returns 0 or an error code."""
        self.advance(now)
        if not self.armed:
            return BUSY
        if self.mode != "idle":
            return REFUSED
        x, y, z = self.estimate(now)
        self._fly(Segment(start=(x, y, z), target=(x, y, height_m), duration_s=duration_s, began_s=now), "flying")
        return 0

    def go_to(self, target: Position, duration_s: float, now: float) -> int:
        """Fly from the last set-point with its velocity, as the firmware plans it; returns 0 or an error code."""
        self.advance(now)
        if not self.armed:
            return BUSY
        at, velocity, acceleration = self.set_point(now)
        segment = Segment(
            start=at, target=target, duration_s=duration_s, began_s=now, velocity=velocity, acceleration=acceleration
        )
        self._fly(segment, "flying")
        return 0

    def land(self, height_m: float, duration_s: float, now: float) -> int:
        """Returns 0 or an error code."""
        self.advance(now)
        if not self.armed:
            return BUSY
        if self.mode == "landing":
            return REFUSED
        start, _, _ = self.set_point(now)
        self._fly(Segment(start=start, target=(*start[:2], height_m), duration_s=duration_s, began_s=now), "landing")
        return 0

    def stop(self, now: float) -> int:
        """Stop the motors, as the high-level commander does; the body falls."""
        self.advance(now)
        self._motors_off(now)
        return 0

    def emergency_stop(self, now: float) -> None:
        """Stop the motors until a restart."""
        self.stop(now)
        self.locked, self.armed = True, False

    def set_point(self, now: float) -> tuple[Position, Position, Position]:
        """Set-point of the high-level commander: position [m], velocity [m/s], acceleration [m/s^2]."""
        if self._segment is None:
            return self.estimate(now), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        return self._segment.at(now)

    def _fly(self, segment: Segment, mode: Mode) -> None:
        now = segment.began_s
        here = self.position(now)
        self._segment, self.mode, self._fell = segment, mode, None
        self._set_error(here, now)
        if self._controller is None:
            self._take_control(here, now)

    def _set_error(self, here: Position, now: float) -> None:
        """Store the distance between the body and its set-point, which is flown off."""
        believed, _, _ = self.set_point(now)
        x, y, z = (p + o - b for p, o, b in zip(here, self._offset, believed, strict=True))
        self._error, self._error_at = (x, y, z), now

    def _motors_off(self, now: float) -> None:
        if self._segment is None:
            return
        mode, self.mode = self.mode, "idle"
        self._rest = self.position(now)
        self._controller = None
        if mode == "landing" and self._rest[2] < self.ground_m + FALL_HEIGHT:
            self._rest = (self._rest[0], self._rest[1], self.ground_m)
        self._segment = None
        self._fell = now if self._rest[2] > self.ground_m else None

    def jump(self, offset: Position, now: float) -> None:
        """Shift the estimate from now on [m]; in flight the body then follows its wrong estimate."""
        here = self.position(now)
        x, y, z = (a + b for a, b in zip(self._offset, offset, strict=True))
        self._offset = (x, y, z)
        if self._controller is not None:
            self._controller.shift(offset)
        if self._segment is not None:
            self._set_error(here, now)

    def stall(self, now: float, stalled: bool = True) -> None:
        """Freeze the estimate from now on, with growing variance; or let it work again."""
        self._stalled = (now, self.estimate(now)) if stalled else None
