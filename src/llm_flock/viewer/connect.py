"""A running swarm of processes, watched from outside: it flies the same whether anybody looks or not."""

from __future__ import annotations

import asyncio
import logging

from llm_flock.errors import FlockError, InputError
from llm_flock.runtime.network.config import SwarmConfig
from llm_flock.runtime.network.watch import give_mission, look, observing, run_info
from llm_flock.viewer.reel import Reel

logger = logging.getLogger(__name__)


class Swarm:
    """A swarm on the network.

    Args:
        config: where it is and what it flies.
        reel: shows it.
    """

    def __init__(self, config: SwarmConfig, reel: Reel) -> None:
        self.config = config
        self.reel = reel

    def watch(self) -> None:
        """Listen until the process ends; to be called in a thread of its own."""
        try:
            asyncio.run(self._watch())
        except FlockError as error:
            self.reel.failure = str(error)
            logger.warning("%s", error)
        finally:
            self.reel.close()

    async def _watch(self) -> None:
        self.reel.write(run_info(self.config))
        with observing(self.config, self.reel) as observer:
            await look(observer)

    async def change(self, fields: dict[str, object]) -> int:
        """Give the swarm another mission; returns the robot that took it.

        Raises:
            InputError: the mission cannot be changed like that, or nobody is there.
        """
        self.config.mission.change(**fields)
        taker = await give_mission(self.config, fields, None)
        if taker is None:
            raise InputError("connect", self.config.network.connect, "where a swarm runs; nobody was there")
        return taker
