"""How a Crazyflie with its stock PID controller follows a set-point: a model for stand-ins.

The position's controller asks for a velocity, from the distance to the set-point alone: there is no feed-forward of the
set-point's own velocity. The velocity's controller asks for a tilt, or for thrust (firmware: `positionController` in
`src/modules/src/controller/position_controller_pid.c`, gains in `src/platform/interface/platform_defaults_cf2.h`). So
the drone is behind a moving set-point by about its speed over the gain. Attitude and thrust follow at once but for a
first-order delay; there is no drag and no noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from llm_flock.robots import Position

STEP_S = 0.01  # one turn of the position's controller, 100 a second [s]
GRAVITY = 9.81  # [m/s^2]

MAX_TILT_DEG = 20.0
MAX_SPEED_M_S = 1.1
"""Limits of what is asked for: `PID_VEL_ROLL_MAX`, and `PID_POS_VEL_X_MAX` with its overhead of 10 %."""

MAX_DELAY_S = 60.0  # a body that was not looked at for longer than this rests at its set-point [s]

HOVER_THRUST, THRUST_SCALE = 36000.0, 1000.0
"""`PID_VEL_THRUST_BASE`, and the units of thrust in one of the velocity's controller."""


@dataclass(slots=True)
class _Axis:
    """State of one axis, and its gains: of the position, of its integral, of the velocity, of its integral."""

    place: float
    gains: tuple[float, float, float, float]
    upward: bool = False
    speed: float = 0.0
    pull: float = 0.0
    sums: tuple[float, float] = (0.0, 0.0)

    def ask(self, target: float, gain: float) -> float:
        """The acceleration that the controller asks for, one step on [m/s^2]."""
        _, position_i, velocity_p, velocity_i = self.gains
        off = target - self.place
        first = self.sums[0] + off * STEP_S
        wanted = max(-MAX_SPEED_M_S, min(MAX_SPEED_M_S, gain * off + position_i * first))
        slow = wanted - self.speed
        second = self.sums[1] + slow * STEP_S
        asked = velocity_p * slow + velocity_i * second
        if self.upward:
            pull = GRAVITY * max(-1.0, THRUST_SCALE * asked / HOVER_THRUST)
        else:
            pull = GRAVITY * math.tan(math.radians(max(-MAX_TILT_DEG, min(MAX_TILT_DEG, asked))))
        self.sums = (first, second)
        return pull

    def step(self, target: float, gain: float) -> None:
        """One step of controller and body."""
        pull = self.ask(target, gain)
        self.pull += (pull - self.pull) * STEP_S / 0.08  # tilt and thrust follow with a delay
        self.speed += self.pull * STEP_S
        self.place += self.speed * STEP_S


@dataclass(slots=True, kw_only=True)
class Cascade:
    """A body with the stock controller, at rest at `place` [m] at `now` [s]; `gain` is `posCtlPid.xKp` [1/s]."""

    place: Position
    now: float
    gain: float = 2.0
    _axes: tuple[_Axis, _Axis, _Axis] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        x, y, z = self.place
        level, upright = (self.gain, 0.0, 25.0, 1.0), (self.gain, 0.5, 25.0, 15.0)
        self._axes = (_Axis(x, level), _Axis(y, level), _Axis(z, upright, upward=True))

    def behind(self, now: float) -> bool:
        """Whether a step is due."""
        return now - self.now >= STEP_S

    def step(self, set_point: Position, floor_m: float) -> None:
        """One step of `STEP_S` towards a set-point [m]; the floor stops a fall."""
        for axis, target in zip(self._axes, set_point, strict=True):
            axis.step(target, self.gain)
        up = self._axes[2]
        if up.place < floor_m:
            up.place, up.speed = floor_m, max(0.0, up.speed)
        self.now += STEP_S
        self._settle()

    def fly(self, now: float, set_point: Callable[[float], Position], floor_m: float) -> None:
        """Fly on until now, after the set-point [m] at each time."""
        if now - self.now > MAX_DELAY_S:
            self.place, self.now = set_point(now), now
            self.__post_init__()
        while self.behind(now):
            self.step(set_point(self.now + STEP_S), floor_m)

    def ask(self, set_point: Position, place: Position, velocity: Position) -> Position:
        """The acceleration commanded for a body that other code moves, 100 times a second [m/s^2]."""
        asked: list[float] = []
        for axis, target, here, speed in zip(self._axes, set_point, place, velocity, strict=True):
            axis.place, axis.speed = here, speed
            asked.append(axis.ask(target, self.gain))
        x, y, z = asked
        return (x, y, z)

    def shift(self, offset: Position) -> None:
        """Move what the body believes its place to be [m]."""
        for axis, by in zip(self._axes, offset, strict=True):
            axis.place += by
        self._settle()

    def _settle(self) -> None:
        x, y, z = (axis.place for axis in self._axes)
        self.place = (x, y, z)


def pid(gain: float = 2.0) -> Callable[[Position, float], Cascade]:
    """Makes a `PointMass` follow its set-point as the stock controller does, with this gain of the position [1/s]."""
    return lambda place, now: Cascade(place=place, now=now, gain=gain)
