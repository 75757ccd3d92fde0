"""A swarm on the network for programs that watch it: a plug-in of the kind `watches`."""

from __future__ import annotations

from pathlib import Path

from llm_flock.errors import InputError
from llm_flock.record import RecordSink
from llm_flock.runtime import run_info
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.watch import give_mission, look, observing


class WatchedSwarm:
    """A `WatchedTeam`; the swarm flies the same whether it is watched or not."""

    def __init__(self, config: SwarmConfig) -> None:
        self.config = config
        self.name = f"swarm {config.network.swarm}"

    async def follow(self, sink: RecordSink) -> None:
        sink.write(run_info(self.config, simulated=self.config.simulated, unrepeatable=self.config.unrepeatable))
        with observing(self.config, sink) as observer:
            await look(observer)

    async def give(self, fields: dict[str, object]) -> int:
        self.config.mission.change(**fields)
        takers = await give_mission(self.config, fields, None)
        if not takers:
            raise InputError("connect", self.config.network.connect, says="no robot answers there")
        return takers[0]


def watch(file: Path | None, connect: str | None, name: str | None) -> WatchedSwarm:
    """The swarm of a configuration file, at an endpoint, of a name; each overrides what the file says."""
    return WatchedSwarm(SwarmConfig.load(file, connect=connect, swarm=name))
