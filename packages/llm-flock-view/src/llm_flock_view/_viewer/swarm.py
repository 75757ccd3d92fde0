"""A team of other processes, watched from outside; it flies the same with or without a viewer."""

from __future__ import annotations

import asyncio
from typing import Any

from llm_flock.errors import FlockError
from llm_flock.record import RecordSink, Tee
from llm_flock.runtime import WatchedTeam
from llm_flock_view._viewer.recording import Recording


class SwarmSource:
    """Feeds a recording from such a team."""

    def __init__(self, team: WatchedTeam, recording: Recording) -> None:
        self.team = team
        self.recording = recording
        recording.steer = self._steer
        self.also: RecordSink | None = None  # takes every entry as well

    def watch(self) -> None:
        """Listen until the process ends. Call it in a thread."""
        sink = self.recording if self.also is None else Tee(self.recording, self.also)
        try:
            asyncio.run(self.team.follow(sink))
        except FlockError as error:
            self.recording.fail(error)
        finally:
            self.recording.open = False

    def _steer(self) -> dict[str, Any]:
        """What can be ordered: another mission, while anybody may answer."""
        mission = self.team.config.mission
        return {
            "kind": "swarm",
            "run": None if self.recording.open else "The swarm is no longer watched.",
            "mission": {"shape": mission.shape, "center": list(mission.center)},
        }
