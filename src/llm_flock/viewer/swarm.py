"""A running swarm of processes, watched from outside; it flies the same with or without a viewer."""

from __future__ import annotations

import asyncio

from llm_flock.errors import FlockError, InputError
from llm_flock.runtime.entries import run_info
from llm_flock.runtime.network.config import SwarmConfig
from llm_flock.runtime.network.watch import give_mission, look, observing
from llm_flock.viewer.recording import Recording


class SwarmSource:
    """Feeds a recording from a swarm on the network."""

    def __init__(self, config: SwarmConfig, recording: Recording) -> None:
        self.config = config
        self.recording = recording

    def watch(self) -> None:
        """Listen until the process ends. Call it in a thread."""
        try:
            asyncio.run(self._watch())
        except FlockError as error:
            self.recording.fail(error)
        finally:
            self.recording.open = False

    async def _watch(self) -> None:
        self.recording.write(run_info(self.config, simulated=self.config.simulated))
        with observing(self.config, self.recording) as observer:
            await look(observer)

    async def change(self, fields: dict[str, object]) -> int:
        """Give the swarm another mission; returns the robot that took it.

        Raises:
            InputError: the mission cannot be changed like that, or no robot answers.
        """
        self.config.mission.change(**fields)
        taker = await give_mission(self.config, fields, None)
        if taker is None:
            raise InputError("connect", self.config.network.connect, "where a swarm runs; no robot answered")
        return taker
