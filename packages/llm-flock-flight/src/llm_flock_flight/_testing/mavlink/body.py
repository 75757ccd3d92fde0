"""The body of a stand-in: a point mass that follows set-points with a lag, and falls without motors. Reads no clock."""

from __future__ import annotations

from dataclasses import dataclass, field

from llm_flock.robots import Position

STEP_S = 0.005  # step of the integration [s]
GAIN = 3.0  # speed towards a set-point, by distance [1/s]

GRAVITY = 9.81
LANDING_M_S, FAST_LANDING_M_S = 0.7, 1.5
CLIMB_M_S = 0.8  # of a landing, a lifelike one's with its throttle stick at zero, and of a take-off by itself [m/s]

CLIMB_M_S2, CLIMB_LAG_S = 1.0, 0.2  # of a lifelike body: most vertical acceleration, and time constant of its climb
LAG_S = 0.08  # time constant of the speed, elsewhere [s]
DRAG = 0.3  # acceleration by the wind, by the speed of the air past the body [1/s]

REST: Position = (0.0, 0.0, 0.0)


@dataclass(slots=True)
class Airframe:
    """Position [m] and velocity [m/s] (north, east, down) from the place where it was switched on; the ground is at 0.

    It flies to `target` [m], which moves with `feed_forward` [m/s]; None to stop. It has moved up to the time `at_s`. A
    `lifelike` one climbs and sinks as sluggishly as ArduCopter's, by its own simulator. `wind` [m/s] pushes it aloft.
    """

    ned: Position = REST
    velocity: Position = REST
    target: Position | None = None
    feed_forward: Position = REST
    motors: bool = False
    lifted: bool = False
    lifelike: bool = False
    wind: Position = REST
    at_s: float = field(default=0.0)

    @property
    def height_m(self) -> float:
        """Above the ground [m]."""
        return -self.ned[2]

    def advance(self, now: float) -> None:
        """Move until `now`; a long gap is cut short."""
        self.at_s = max(self.at_s, now - 1.0)
        while self.at_s + STEP_S <= now:
            self.at_s += STEP_S
            self._step()

    def _step(self) -> None:
        if not self.motors:
            self.lifted = False
            fall = self.velocity[2] + GRAVITY * STEP_S if self.height_m > 0.0 else 0.0
            self.velocity = (0.0, 0.0, fall)
        elif self.lifted:
            wanted = self._desired_velocity()
            north, east, down = (v + STEP_S / LAG_S * (w - v) for v, w in zip(self.velocity, wanted, strict=True))
            if self.lifelike:
                pull = (wanted[2] - self.velocity[2]) / CLIMB_LAG_S
                down = self.velocity[2] + STEP_S * min(max(pull, -CLIMB_M_S2), CLIMB_M_S2)
            if any(self.wind):
                pairs = zip((north, east, down), self.wind, self.velocity, strict=True)
                north, east, down = (v + STEP_S * DRAG * (w - old) for v, w, old in pairs)
            self.velocity = (north, east, down)
        else:
            self.velocity = REST
        north, east, down = (p + v * STEP_S for p, v in zip(self.ned, self.velocity, strict=True))
        self.ned = (north, east, min(down, 0.0))
        if down > 0.0:
            self.velocity = REST

    def _desired_velocity(self) -> Position:
        if self.target is None:
            return REST
        rows = [f + GAIN * (t - p) for t, p, f in zip(self.target, self.ned, self.feed_forward, strict=True)]
        north, east, down = (min(max(v, -4.0), 4.0) for v in rows)
        return (north, east, down)
