"""A running swarm of processes, watched from outside; it flies the same with or without a viewer."""

from __future__ import annotations

import asyncio
from typing import Any

from llm_flock.errors import FlockError, InputError
from llm_flock.record.writer import RecordSink, Tee
from llm_flock.runtime.entries import run_info
from llm_flock.runtime.network.config import SwarmConfig
from llm_flock.runtime.network.watch import give_mission, look, observing
from llm_flock.viewer.recording import Recording


class SwarmSource:
    """Feeds a recording from a swarm on the network."""

    def __init__(self, config: SwarmConfig, recording: Recording) -> None:
        self.config = config
        self.recording = recording
        recording.steer = self._steer
        self.also: RecordSink | None = None  # takes every entry as well

    def watch(self) -> None:
        """Listen until the process ends. Call it in a thread."""
        try:
            asyncio.run(self._watch())
        except FlockError as error:
            self.recording.fail(error)
        finally:
            self.recording.open = False

    async def _watch(self) -> None:
        sink = self.recording if self.also is None else Tee(self.recording, self.also)
        sink.write(run_info(self.config, simulated=self.config.simulated, unrepeatable=self.config.unrepeatable))
        with observing(self.config, sink) as observer:
            await look(observer)

    def _steer(self) -> dict[str, Any]:
        """What can be ordered: another mission, while anybody may answer."""
        mission = self.config.mission
        return {
            "kind": "swarm",
            "run": None if self.recording.open else "The swarm is no longer watched.",
            "mission": {"shape": mission.shape, "center": list(mission.center)},
        }

    async def change(self, fields: dict[str, object]) -> int:
        """Give the swarm another mission; returns the robot that took it.

        Raises:
            InputError: the mission cannot be changed like that, or no robot answers.
        """
        self.config.mission.change(**fields)
        takers = await give_mission(self.config, fields, None)
        if not takers:
            raise InputError("connect", self.config.network.connect, says="no robot answers there")
        return takers[0]
