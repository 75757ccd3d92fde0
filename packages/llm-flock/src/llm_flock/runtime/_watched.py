"""A team that other processes fly, as programs see it that watch it: what a plug-in of the kind `watches` provides."""

from __future__ import annotations

from typing import Protocol

from llm_flock.record._schema import RecordSink
from llm_flock.runtime._config import RunConfig


class WatchedTeam(Protocol):
    """Made by the plug-in, a function of a configuration file, an endpoint and a name; None where one is not given.

    Attributes:
        name: of the team, for titles.
    """

    name: str

    @property
    def config(self) -> RunConfig:
        """How the team flies, as far as it is known here."""
        ...

    async def follow(self, sink: RecordSink) -> None:
        """Write what the team does, as a record would hold it, until cancelled."""
        ...

    async def give(self, fields: dict[str, object]) -> int:
        """Change the team's mission; returns the robot that took the order.

        Raises:
            InputError: the mission cannot be changed like that, or no robot answers.
        """
        ...
