"""Drones with the dynamics of real Crazyflies: crazyflow's identified models, Mellinger's controller or the stock one.

The high-level commander, arming and faults are the point mass's; only the position comes from the physics, so the body
lags behind its set-point as a real one does. Batteries, estimators and downwash are not modelled. crazyflow is an extra
of more than a gigabyte (`pip install 'llm-flock[physics]'`), imported when a world is built; it needs SCIPY_ARRAY_API=1
in the environment from the start of the process.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal

import numpy as np

from llm_flock.arrays import Points
from llm_flock.errors import InputError
from llm_flock.extras import require
from llm_flock.robots import FALL_HEIGHT, Equipment, Mode, MotionLimits, PointMass, Position, Segment, SimulatedRobot
from llm_flock_flight._cascade import GRAVITY, Cascade

STEP_S = 0.01
"""Time between two set-points, as from the firmware's high-level commander (`RATE_HL_COMMANDER`, 100 Hz) [s]."""

SUBSTEPS = 5  # steps of the dynamics and the attitude controller in each of these, hence 500 Hz

DRONE = "cf2x_L250"
"""crazyflow's Crazyflie 2.1; its Brushless, `cf21B_500`, flies 8 cm too high (docs/explanation/physics.md)."""


@dataclass(slots=True, kw_only=True)
class PhysicalBody(PointMass):
    """A body whose position comes from the physics while its motors turn."""

    world: PhysicsWorld
    index: int

    def position(self, now: float) -> Position:
        """The body's position [m]; in flight as of the last step of the world."""
        self.advance(now)
        return self._place() if self.flying else PointMass.position(self, now)

    def _place(self) -> Position:
        x, y, z = self.world.positions[self.index].tolist()
        return (x, y, z)

    def _motors_off(self, now: float) -> None:
        """From its position in the simulation: onto the ground, or falling."""
        if not self.flying:
            return
        x, y, z = self._place()
        low = z < self.ground_m + FALL_HEIGHT
        self.mode, self._segment = "idle", None
        self._rest, self._fell = (x, y, self.ground_m if low else z), None if low else now

    def _fly(self, segment: Segment, mode: Mode) -> None:
        if not self.flying:
            self.world.place(self.index, self.position(segment.began_s))
        PointMass._fly(self, segment, mode)  # noqa: SLF001  # its own


class PhysicsWorld:
    """All drones of a flight in one simulation, from `homes` above the ground at z = 0; InputError without crazyflow.

    Time passes only in `run_until`. After `start`, or in its context, a thread calls it at the pace of `clock`. The
    controller of the position is crazyflow's Mellinger, or the firmware's PID above crazyflow's control of the
    attitude. `positions` and `targets` are those of the last step, shape (n, 3) [m].
    """

    def __init__(
        self,
        homes: Sequence[Position],
        *,
        drone: str = DRONE,
        clock: Callable[[], float] = time.monotonic,
        controller: Literal["mellinger", "pid"] = "mellinger",
    ) -> None:
        require("physics", "simulated physics")
        try:
            control: Any = import_module("crazyflow.control")  # untyped, and too large to be installed for type checks
            simulation: Any = import_module("crazyflow.sim")
        except RuntimeError as error:
            # It needs scipy's array API, which the environment selects when scipy is first imported.
            raise InputError("physics", str(error), says="set SCIPY_ARRAY_API=1 in the environment") from None
        freq = round(SUBSTEPS / STEP_S)
        try:
            self._sim: Any = simulation.Sim(
                n_drones=len(homes),
                drone=drone,
                control=control.Control.attitude if controller == "pid" else control.Control.state,
                freq=freq,
                state_freq=freq // SUBSTEPS,
            )
        except (ValueError, AssertionError, FileNotFoundError, KeyError) as error:
            raise InputError("drone", drone, f"a kind of drone that crazyflow knows ({error})") from None
        self.clock = clock
        self._pid: dict[int, Cascade] | None = {} if controller == "pid" else None
        self.bodies = [PhysicalBody(home=home, world=self, index=k) for k, home in enumerate(homes)]
        self.positions: Points = np.array(homes, dtype=np.float64)
        self.targets: Points = self.positions.copy()
        self._lock = threading.RLock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="physics", daemon=True)
        self.time_s = clock()
        self._write(slice(None))
        self._warm_up()
        self.time_s = clock()

    def robot(
        self, index: int, name: str, limits: MotionLimits | None = None, equipment: Equipment | None = None
    ) -> SimulatedRobot:
        """A driver of one of the drones."""
        body = self.bodies[index]
        return SimulatedRobot(name, body.home, limits=limits, clock=self.clock, body=body, equipment=equipment)

    def run_until(self, time_s: float) -> None:
        """Let time pass until then, in steps of `STEP_S`."""
        while self.time_s + STEP_S <= time_s:
            with self._lock:
                self._step()

    def place(self, index: int, position: Position) -> None:
        """Put one drone somewhere, at rest [m]."""
        with self._lock:
            self.positions[index] = position
            self._write(index)

    def start(self) -> None:
        """Let time pass at the pace of the clock from now on, for as long as the process lives."""
        self.time_s = self.clock()
        self._thread.start()

    def __enter__(self) -> PhysicsWorld:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stop.is_set():
            self.run_until(self.clock())
            self._stop.wait(STEP_S / 2.0)

    def _step(self) -> None:
        commands = np.zeros((1, len(self.bodies), 16), dtype=np.float32)
        commands[0, :, 12] = 1.0  # no rotation
        now = self.time_s
        for k, body in enumerate(self.bodies):
            body.advance(now)
            # On the ground it holds its position, so that its controller has nothing to correct at take-off.
            rows = body.set_point(now) if body.flying else (body.position(now), (0.0,) * 3, (0.0,) * 3)
            commands[0, k, :9] = np.concatenate(rows)
        if self._pid is None:
            self._sim.state_control(commands)
        else:
            self._sim.attitude_control(self._attitudes(self._pid, commands[0, :, :3]))
        self._sim.step(SUBSTEPS)
        self.positions = np.array(self._sim.data.states.pos[0], dtype=np.float64)
        self.targets = commands[0, :, :3].astype(np.float64)
        self.time_s = now + STEP_S

    def _attitudes(self, controllers: dict[int, Cascade], targets: Any) -> Any:
        """Roll, pitch, yaw [rad] and thrust [N] that the stock controllers ask for, shape (1, n, 4)."""
        rows = np.zeros((1, len(self.bodies), 4), dtype=np.float32)
        velocities = np.array(self._sim.data.states.vel[0], dtype=np.float64)
        mass = float(np.ravel(np.array(self._sim.data.params.mass))[0])
        for k, body in enumerate(self.bodies):
            if not body.flying:
                controllers.pop(k, None)
                rows[0, k, 3] = mass * GRAVITY
                continue
            if k not in controllers:
                controllers[k] = Cascade(place=self._place_of(k), now=self.time_s)
            x, y, z = targets[k].tolist()
            u, v, w = velocities[k].tolist()
            ax, ay, az = controllers[k].ask((x, y, z), self._place_of(k), (u, v, w))
            rows[0, k] = (-math.atan2(ay, GRAVITY), math.atan2(ax, GRAVITY), 0.0, mass * (GRAVITY + az))
        return rows

    def _place_of(self, index: int) -> Position:
        x, y, z = self.positions[index].tolist()
        return (x, y, z)

    def _write(self, chosen: int | slice) -> None:
        """Set positions in the simulation, at rest."""
        states = self._sim.data.states
        self._sim.data = self._sim.data.replace(
            states=states.replace(
                pos=states.pos.at[0, chosen].set(self.positions[chosen]),
                vel=states.vel.at[0, chosen].set(0.0),
                ang_vel=states.ang_vel.at[0, chosen].set(0.0),
            )
        )

    def _warm_up(self) -> None:
        """Compile everything now, which takes seconds."""
        data, positions = self._sim.data, self.positions.copy()
        for index in range(2):
            self._step()
            self.place(min(index, len(self.bodies) - 1), self.bodies[0].home)
        self._step()
        self._sim.data, self.positions = data, positions
        self._step()
