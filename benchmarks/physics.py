"""Flights of drones with real dynamics in simulated time: as fast as the processor allows.

SCIPY_ARRAY_API=1 python -m benchmarks physics         the paper's flights and a circle of ten
... physics --runs 3 --controller pid                  seeds 1 to 3, with the stock controller
SCIPY_ARRAY_API=1 python -m benchmarks physics-speed   how much faster than real time 5, 10 and 50 drones are
"""

from __future__ import annotations

import argparse
import asyncio
import logging
import selectors
import time
import warnings
from collections.abc import Sequence
from typing import Any, Literal
from unittest import mock

import numpy as np
from benchmarks.flight import ROOM

from llm_flock.robots._base import Equipment, MotionLimits
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.fleet import start_of, with_drones
from llm_flock_flight._flight.flight import Flight
from llm_flock_flight._physics import STEP_S, PhysicsWorld

FLIGHTS = (("triangle", 3), ("square", 4), ("cross", 5), ("circle", 5), ("circle", 10))
FIELDS: dict[str, Any] = {
    "scale_m": 0.12,
    "tracking_m": 0.08,
    "deadman": False,
    "seed": 1,
}
"""A unit is 12 cm, so that the safe distance of 3 units holds 0.2 m and twice these drones' tracking error."""


class OwnTime:
    """A clock that moves only while an event loop has nothing to do, and a world that moves with it.

    Calling it tells the time.
    """

    def __init__(self) -> None:
        self.now_s = 1000.0
        self.world: PhysicsWorld | None = None

    def __call__(self) -> float:
        return self.now_s

    def pass_(self, seconds: float) -> None:
        """Let time pass."""
        self.now_s += seconds
        if self.world is not None:
            self.world.run_until(self.now_s)


class _Selector(selectors.DefaultSelector):
    """Lets simulated time pass where an event loop would sleep."""

    def __init__(self, clock: OwnTime) -> None:
        super().__init__()
        self._clock = clock

    def select(self, timeout: float | None = None) -> Any:
        """Ready events; lets time pass if there are none."""
        events = super().select(0 if timeout is not None else None)
        if not events and timeout is not None and timeout > 0.0:
            self._clock.pass_(max(1e-4, min(timeout, STEP_S)))
        return events


class Watched(PhysicsWorld):
    """A world that measures, at every step, the distances of flying drones from their set-points and each other."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self.errors: list[Any] = []
        self.nearest_m = np.inf
        self.watching = False
        super().__init__(*arguments, **options)
        self.watching = True

    def _step(self) -> None:
        super()._step()
        flying = [k for k, body in enumerate(self.bodies) if body.flying]
        if not self.watching or not flying:
            return
        self.errors.extend(self.positions[flying] - self.targets[flying])
        places = self.positions[flying][:, :2]
        apart = np.linalg.norm(places[:, None] - places[None], axis=2)
        np.fill_diagonal(apart, np.inf)
        self.nearest_m = min(self.nearest_m, float(apart.min()))


async def yes(_: object) -> bool:
    return True


def fly(shape: str, n: int, controller: Literal["mellinger", "pid"] = "mellinger", **fields: Any) -> str:
    """One flight; a row of the table."""
    mission = {"shape": shape, "n_robots": n, **ROOM}
    config = with_drones(FlightConfig.build({"mission": mission}, **{**FIELDS, **fields}))
    homes = [start_of(config, drone) for drone in config.fleet.drones]
    clock = OwnTime()
    began = time.perf_counter()
    world = clock.world = Watched(homes, clock=clock, controller=controller)
    limits: MotionLimits = config.driver_limits
    stock = Equipment(controller="PID", lag_s=0.5, max_speed_m_s=1.0)  # the gain of its position is 2 per second
    kind = stock if controller == "pid" else None
    robots = [world.robot(k, f"cf{k}", limits, kind) for k in range(n)]
    with mock.patch("time.monotonic", clock):
        loop = asyncio.SelectorEventLoop(_Selector(clock))
        try:
            result = loop.run_until_complete(Flight(config, robots).run(yes))
        finally:
            loop.close()
    assert result.result is not None, [str(check) for check in result.report.checks if not check.passed]
    summary = result.result.summary
    assert summary.flight is not None
    off = np.array(world.errors)
    rms, plane = (100 * float(np.sqrt(np.mean(np.sum(x * x, axis=1)))) for x in (off, off[:, :2]))
    most = 100 * float(np.linalg.norm(off, axis=1).max())
    landed = set(summary.flight.ends.values()) == {"landed"}
    return (
        f"| {shape} {n} | {'yes' if summary.formed else 'NO'}, {summary.rounds} rounds | {'yes' if landed else 'NO'} "
        f"({summary.flight.ended}) | {rms:.1f} | {plane:.1f} | {most:.1f} | {world.nearest_m:.3f} "
        f"| {summary.flight.air_s:.0f} | {time.perf_counter() - began:.0f} |"
    )


def flights() -> None:
    """Bar 3: formed, tracking error under 5 cm rms, true separation never below the physical minimum of 0.2 m."""
    main(())


def main(arguments: Sequence[str]) -> None:
    """Read the options, fly, and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks physics")
    parser.add_argument("--runs", type=int, default=1, help="random starts of each flight, seeds from 1 on")
    parser.add_argument("--controller", choices=("mellinger", "pid"), default="mellinger", help="of the position")
    given = parser.parse_args(arguments)
    _quiet()
    print("| Flight | Formed | Landed | Off, rms [cm] | Plane [cm] | Most [cm] | Nearest [m] | Air [s] | Took [s] |")
    print("|---|---|---|---|---|---|---|---|---|")
    for shape, n in FLIGHTS:
        for seed in range(1, given.runs + 1):
            print(fly(shape, n, given.controller, seed=seed), flush=True)


def speed() -> None:
    """All drones on their way, four seconds of it, after compilation."""
    _quiet()
    print("| Drones | Times real time |")
    print("|---|---|")
    for n in (5, 10, 50):
        clock = OwnTime()
        world = clock.world = PhysicsWorld([(0.6 * (k % 8), 0.6 * (k // 8), 0.0) for k in range(n)], clock=clock)
        for body in world.bodies:
            body.arm(True)
            body.take_off(0.5, 2.0, clock())
        clock.pass_(0.5)
        began = time.perf_counter()
        clock.pass_(4.0)
        print(f"| {n} | {4.0 / (time.perf_counter() - began):.1f} |", flush=True)


def _quiet() -> None:
    warnings.simplefilter("ignore")
    logging.disable(logging.WARNING)
