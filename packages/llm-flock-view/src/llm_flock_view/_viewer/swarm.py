"""Watches a swarm in other processes; watching does not change how it flies."""

from __future__ import annotations

import asyncio
from typing import Any, Protocol

from llm_flock.printable import printable
from llm_flock.record import Guarded, RecordSink, Tee
from llm_flock.runtime import RunConfig
from llm_flock_view._viewer.recording import Recording


class WatchedTeam(Protocol):
    """A team that a plug-in of the kind `watches` opened, by a configuration file, an endpoint and a name."""

    name: str

    @property
    def config(self) -> RunConfig:
        """How the team flies, as far as it is known here."""
        ...

    async def follow(self, sink: RecordSink) -> None:
        """Write what the team does, as a record would hold it, until cancelled."""
        ...

    async def give(self, fields: dict[str, object]) -> int:
        """Change the team's mission; returns the robot that took the order. `InputError` if none did."""
        ...


class SwarmSource:
    """Feeds a recording from a watched team."""

    def __init__(self, team: WatchedTeam, recording: Recording) -> None:
        self.team = team
        self.recording = recording
        recording.steer = self._steer
        self.also: RecordSink | None = None  # takes every entry as well

    def watch(self) -> None:
        """Listen until the process ends. Call it in a thread."""
        ended: dict[str, Exception] = {}
        sink = self.recording if self.also is None else Tee(self.recording, Guarded("feed", self.also.write, ended))
        Guarded("view", lambda: asyncio.run(self.team.follow(sink)), ended)()
        self.recording.failure = printable(str(ended["view"])) if "view" in ended else None
        self.recording.open = False

    def _steer(self) -> dict[str, Any]:
        """The possible orders: another mission, while a robot may answer."""
        mission = self.team.config.mission
        return {
            "kind": "swarm",
            "run": None if self.recording.open else "The swarm is no longer watched.",
            "mission": {"shape": mission.shape, "center": list(mission.center)},
        }
