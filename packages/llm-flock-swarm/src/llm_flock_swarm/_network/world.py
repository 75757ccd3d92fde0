"""The world process: every robot's simulated body and sensors. It knows no plan, no goal and no agent.

A body obeys a command that arrives in time and begins where the body will stop; it answers every command by its number.
If the deadline passes before the end of the path, it stops where it is: no body moves on outdated commands.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from contextlib import closing

import numpy as np

from llm_flock import metrics
from llm_flock.arrays import Point, Points, between
from llm_flock.members import WORLD
from llm_flock.runtime import finite, starts_of
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.connection import open_link
from llm_flock_swarm._network.process import until_stopped
from llm_flock_swarm._network.receiving import receive
from llm_flock_swarm._network.wire import Body, Command, WorldState, pack
from llm_flock_swarm._zenoh import ZenohLink

SUBSTEP_S = 0.01  # longest piece of a path along which the separation is measured: paths have corners [s]
SAME_POSITION = 1e-9  # two positions this near are the same [units]


class WorldBodies:
    """True positions of all bodies, and the path that each is flying [units; units/s].

    A command is at most `lag_s` old on arrival; its segment is to be flown in `period_s`, its deadline is later by
    `lag_s`.
    """

    def __init__(
        self, start: Points, *, speed: float, period_s: float, lag_s: float, now: float, downwash: float = 1.0
    ) -> None:
        self.positions: Points = np.array(start, dtype=np.float64)
        self.late, self._downwash = 0, downwash
        self._closest = metrics.min_separation(self.positions, downwash)
        self._standing: float | None = None
        self._speed, self._period_s, self._lag_s = speed, period_s, lag_s
        self._now = now
        self._paths: list[list[Point]] = [[] for _ in self.positions]
        self._deadlines = [now] * len(self.positions)
        self._answered = [0] * len(self.positions)

    def command(self, robot: int, order: Command, now: float) -> bool:
        """Take a command; returns whether it is obeyed."""
        self.advance(now)
        if order.number <= self._answered[robot]:
            return False
        self._answered[robot] = order.number
        end = self._end(robot)
        usable = len(order.target) == len(end) and all(map(math.isfinite, order.target))
        if not usable or abs(now - order.stamp) > self._lag_s:
            self.late += 1
            return False
        if len(order.origin) != len(end) or math.dist(order.origin, end) > SAME_POSITION:
            return False
        self._paths[robot].append(order.target)
        self._deadlines[robot] = order.stamp + self._period_s + self._lag_s
        return True

    def advance(self, now: float) -> None:
        """Fly until now, and measure the separation on the way."""
        if now < self._now - self._lag_s:  # the clock was set back; bodies do not wait until it has caught up
            self._now = now
        while self._now < now:
            step = min(SUBSTEP_S, now - self._now)
            if not any(self._paths):
                self._now = now
                return
            before = self.positions.copy()
            for robot, path in enumerate(self._paths):
                if path:
                    self._fly(robot, path, step)
            self._now += step
            closest = metrics.segment_separation(before, self.positions, downwash=self._downwash)
            self._closest = min(self._closest, closest)

    def _fly(self, robot: int, path: list[Point], step: float) -> None:
        left = self._speed * min(step, self._deadlines[robot] - self._now)
        here: Point = tuple(self.positions[robot].tolist())
        while path and left > 0.0:
            distance = math.dist(here, path[0])
            if distance <= left:
                left -= distance
                here = path.pop(0)
            else:
                here = between(here, path[0], left / distance)
                left = 0.0
        if path and self._deadlines[robot] <= self._now + step:
            path.clear()
        self.positions[robot] = here

    def _end(self, robot: int) -> Point:
        path = self._paths[robot]
        return path[-1] if path else tuple(self.positions[robot].tolist())

    def closest(self) -> float:
        """Smallest distance of two bodies since the last call, also along their segments [units]."""
        closest, self._closest = self._closest, math.inf
        if closest < math.inf:
            self._standing = None
            return closest
        if self._standing is None:  # the first call since the bodies stopped
            self._standing = metrics.min_separation(self.positions, self._downwash)
        return self._standing

    def states(self) -> tuple[Body, ...]:
        rows = enumerate(self.positions.tolist())
        return tuple(Body(tuple(row), self._end(robot), self._answered[robot]) for robot, row in rows)


async def run_world(config: SwarmConfig, on_ready: Callable[[], object] | None = None) -> None:
    """Simulate the bodies until the process is stopped; `on_ready` is called once the endpoint is open."""
    mission, network, start = config.mission, config.network, starts_of(config)
    bodies = WorldBodies(
        start,
        speed=config.speed,
        period_s=network.control_s,
        lag_s=network.lag_s,
        now=time.time(),
        downwash=mission.downwash,
    )

    def obey(sender: int, order: Command) -> None:
        if 0 <= sender < mission.n_robots:
            bodies.command(sender, order, time.time())

    async def publish_states(link: ZenohLink) -> None:
        while True:
            now = time.time()
            bodies.advance(now)
            state = WorldState(stamp=now, closest=finite(bodies.closest()), bodies=bodies.states(), late=bodies.late)
            link.publish("frame", WORLD, pack(state))
            await asyncio.sleep(network.frame_s)

    with closing(open_link(config, WORLD)) as link:
        receive(link, "command", Command, obey)
        link.declare_alive(WORLD)
        if on_ready is not None:
            on_ready()
        await until_stopped(publish_states(link))
