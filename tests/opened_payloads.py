"""Counts the payloads that an agent opens: repeated ones may be opened once a round only."""

from __future__ import annotations

from collections.abc import Callable

from llm_flock.agent import Agent
from llm_flock.protocol._messages.channel import Inbound


class Opened:
    """The payloads that an agent's channel opens."""

    def __init__(self, agent: Agent) -> None:
        self.payloads: list[bytes] = []
        channel = agent._messaging.channel
        opens = channel.open

        def opened(payload: bytes, sender: int | None) -> Inbound:
            self.payloads.append(payload)
            return opens(payload, sender)

        channel.open = opened

    def during(self, act: Callable[[], object]) -> int:
        """How many payloads are opened meanwhile."""
        before = len(self.payloads)
        act()
        return len(self.payloads) - before
