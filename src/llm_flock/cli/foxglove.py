"""Serves the runs of commands to Foxglove, with the orders that each of them takes."""

from __future__ import annotations

import asyncio
import signal
import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from llm_flock.cli.terminal import say
from llm_flock.errors import InputError

if TYPE_CHECKING:
    from llm_flock.foxglove.options import Service
    from llm_flock.foxglove.server import FoxgloveServer
    from llm_flock.foxglove.services import Orders
    from llm_flock.runtime.config import RunConfig
    from llm_flock.runtime.network.config import SwarmConfig
    from llm_flock.runtime.network.swarm import Swarm
    from llm_flock.runtime.orders import RunOrders
    from llm_flock.runtime.trial import Trial

PACE = 2.0
"""Rounds a second at most while Foxglove shows a run: simulated models would be over before anybody connects."""


@contextmanager
def showing_run(service: Service, config: RunConfig, orders: Orders) -> Generator[FoxgloveServer | None]:
    """The server while a run flies; None where Foxglove was not asked for.

    Raises:
        InputError: the port is taken, the token too short, or the extra not installed.
    """
    port = service.listen()
    if port is None:
        yield None
        return
    from llm_flock.foxglove.server import serving
    from llm_flock.runtime.entries import run_info

    with serving(port, orders, config.mission.n_robots) as server:
        ordered = "orders with this token" if port.token is not None and orders else "no orders"
        say(f"Foxglove: {server.url} ({ordered})", error=True)
        server.write(run_info(config, simulated="simulated:" in config.model.model))
        yield server


def run_orders(orders: RunOrders) -> Orders:
    """Orders to a run in this process."""
    from llm_flock.foxglove.services import Orders

    return Orders(mission=orders.change, kill=orders.kill)


class Pacer:
    """Steers a run: holds it to a pace [rounds/s], and carries out orders."""

    def __init__(self, pace: float, orders: RunOrders) -> None:
        self._pace = pace
        self._orders = orders
        self._due = 0.0

    async def __call__(self, trial: Trial) -> None:
        """Wait until the next round is due."""
        await asyncio.sleep(max(0.0, self._due - time.monotonic()))
        self._due = time.monotonic() + 1.0 / self._pace
        self._orders.carry_out(trial)


class SwarmOrders:
    """Orders to a swarm: one that runs elsewhere, or one that this command launches and that takes none before.

    With keys an order holds the whole mission, so it repeats what earlier orders changed.
    """

    def __init__(self, config: SwarmConfig, *, launched: bool) -> None:
        self.config = config
        self.swarm: Swarm | None = None
        self._launched = launched
        self._given: dict[str, Any] = {}

    def start(self, swarm: Swarm) -> None:
        """Take orders from now on."""
        self.config, self.swarm = swarm.config, swarm

    def mission(self, fields: dict[str, Any]) -> int:
        """Give a robot the mission, signed by the operator where the swarm has keys.

        Raises:
            InputError: the mission cannot be changed like that, or no robot answers.
        """
        if self._launched and self.swarm is None:
            raise InputError("mission", fields, "possible once the swarm has started")
        fields = {**self._given, **fields}
        taker = swarm_mission(self.config, fields)
        self._given = fields
        return taker

    def kill(self, robot: int) -> None:
        """End the process of a robot, as a fault would.

        Raises:
            InputError: it does not run, or it is the last one.
        """
        running = [] if self.swarm is None else [k for k in self.swarm.pids if k not in self.swarm.ended]
        robots = [name for name in running if name.startswith("robot-")]
        if self.swarm is None or f"robot-{robot}" not in robots:
            raise InputError("robot", robot, "a robot that runs")
        if len(robots) == 1:
            raise InputError("robot", robot, "not the last robot")
        try:
            self.swarm.signal(f"robot-{robot}", signal.SIGKILL)
        except ProcessLookupError:
            raise InputError("robot", robot, "a robot that runs") from None


def swarm_mission(config: SwarmConfig, fields: dict[str, Any]) -> int:
    """Give a running swarm another mission from any thread; see `give_mission`.

    Raises:
        InputError: the mission cannot be changed like that, a key is missing, or no robot answers.
    """
    from llm_flock.runtime.network.watch import give_mission
    from llm_flock.runtime.orders import check_shape

    check_shape(fields.get("shape"))
    config.mission.change(**fields)
    takers = asyncio.run(give_mission(config, fields, None))
    if not takers:
        raise InputError("connect", config.network.connect, "where a swarm runs; no robot answered")
    return takers[0]
