"""A swarm in one event loop: the robots of real processes, their sensors and bodies, and a network between.

Nothing is in step: each robot asks, exchanges and steers at its own times. With `skipped_waits` and `one_clock`, a
flight takes only the time of its work.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from llm_flock.agent import Agent
from llm_flock.arrays import Point
from llm_flock.members import WORLD
from llm_flock.metrics import AT_GOAL
from llm_flock.obstacles import clearance
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.robot import RobotProcess
from llm_flock_swarm._network.wire import Command, RobotReport, WorldState, pack, unpack
from llm_flock_swarm._network.world import WorldBodies
from llm_flock_swarm._zenoh import LinkTraffic

Act = Callable[["AsyncTeam", float], None]


class LoopLink:
    """One robot's end of the network."""

    def __init__(self, team: AsyncTeam) -> None:
        self.traffic = LinkTraffic()
        self.at_hand = b""
        self.handlers: dict[str, Callable[[int, bytes], None]] = {}
        self._team = team

    def listen(self, kind: str, number: int | None, handler: Callable[[int, bytes], None]) -> None:
        self.handlers[kind] = handler

    def publish(self, kind: str, number: int, payload: bytes) -> None:
        self._team.carry(kind, number, payload)

    def watch_alive(self, n_robots: int, handler: Callable[[int, bool], None]) -> None:
        """Does nothing: the robots begin when `gather_s` is over."""

    def declare_alive(self, number: int) -> None:
        """Nobody asks."""

    def close(self) -> None:
        """Nothing is open."""


class AsyncTeam:
    """Robots of a swarm at given starts, shape (n, d) [units]. Call `fly` once.

    Attributes:
        kinds: events that the robots have reported so far, by kind.
        origins: waypoints that each robot has reported, by origin.
        nearest: smallest distance of two bodies so far, also on the way [units].
        clearance: smallest distance of a body's centre from an obstacle so far [units].
    """

    def __init__(self, config: SwarmConfig, starts: Sequence[Point]) -> None:
        self.config = config
        network, now = config.network, time.time()
        self.world = WorldBodies(
            np.array(starts), speed=config.speed, period_s=network.control_s, lag_s=network.lag_s, now=now
        )
        self.kinds = Counter[str]()
        self.origins = [Counter[str]() for _ in starts]
        self.nearest = self.clearance = math.inf
        self.robots: list[RobotProcess] = []
        self._links: list[LoopLink] = []

    @property
    def agents(self) -> list[Agent]:
        return [robot.agent_loop.agent for robot in self.robots]

    def carry(self, kind: str, number: int, payload: bytes) -> None:
        """Bring what a robot sends to whom it concerns."""
        if kind == "command":
            self.world.command(number, unpack(Command, payload), time.time())
        elif kind == "report":
            report = unpack(RobotReport, payload)
            self.kinds.update(event.kind for event in report.happened)
            self.origins[number] = Counter(report.waypoints)
        else:
            for receiver, link in enumerate(self._links):
                if receiver != number:
                    asyncio.get_running_loop().call_soon(link.handlers[kind], number, payload)

    @property
    def formed(self) -> bool:
        """Whether every robot is at a place of its own of one plan."""
        agents, near = self.agents, AT_GOAL * self.config.mission.spacing
        if len({agent.plan for agent in agents}) != 1 or len({agent.claim.slot for agent in agents}) != len(agents):
            return False
        rows = map(tuple, self.world.positions.tolist())
        return all(
            agent.goal is not None and math.dist(x, agent.goal) <= near for agent, x in zip(agents, rows, strict=True)
        )

    def fly(self, most_s: float, act: Act | None = None) -> float | None:
        """Fly; the time after which the formation stands, None if it does not [s]. `act` sees every reading."""
        return asyncio.run(self._fly(most_s, act))

    async def _fly(self, most_s: float, act: Act | None) -> float | None:
        network, mission = self.config.network, self.config.mission
        self._links = [LoopLink(self) for _ in self.world.positions]
        self.robots = [RobotProcess(self.config, i, link) for i, link in enumerate(self._links)]  # pyright: ignore[reportArgumentType]
        tasks = [asyncio.create_task(robot.live()) for robot in self.robots]
        began, found = time.monotonic(), None
        while (passed := time.monotonic() - began) < most_s and found is None:
            now = time.time()
            self.world.advance(now)
            closest = self.world.closest()
            self.nearest = min(self.nearest, closest)
            rows = [tuple(row) for row in self.world.positions.tolist()]
            self.clearance = min(self.clearance, *(clearance(row, mission.obstacles) for row in rows))
            state = pack(WorldState(stamp=now, closest=closest, bodies=self.world.states(), late=self.world.late))
            for link in self._links:
                link.handlers["frame"](WORLD, state)
            if act is not None:
                act(self, passed)
            if self.formed:
                found = passed
            assert not any(task.done() for task in tasks)
            await asyncio.sleep(network.frame_s)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await asyncio.gather(*(robot.planners.close() for robot in self.robots))
        return found


def one_clock(patch: pytest.MonkeyPatch) -> None:
    """Let the wall clock follow the event loop's, which skips waits. Call after `skip_waits`."""
    monotonic, ahead = time.monotonic, time.time() - time.monotonic()
    patch.setattr(time, "time", lambda: monotonic() + ahead)
