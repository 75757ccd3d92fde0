"""Messages and heartbeats received since the last decision."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from llm_flock.protocol.messages.message import Message


class Inbox:
    """The newest message of each sender, and all heartbeats, of one communication round."""

    def __init__(self) -> None:
        self._newest: dict[int, Message] = {}
        self._beats: list[NDArray[np.int64]] = []

    def clear_messages(self) -> None:
        """Drop the messages and keep the heartbeats. Call when another mission comes into force."""
        self._newest = {}

    def add_beats(self, beats: NDArray[np.int64] | None) -> None:
        """Keep the heartbeat counters of a message, shape (N,)."""
        if beats is not None:
            self._beats.append(beats)

    def add(self, message: Message) -> None:
        """Keep a message unless a newer one of its sender is here."""
        known = self._newest.get(message.sender)
        if known is None or message.sequence >= known.sequence:
            self._newest[message.sender] = message

    def drain(self) -> tuple[list[Message], list[NDArray[np.int64]]]:
        """The messages in ascending order of senders, and the heartbeats; empties the inbox."""
        heard, beats = [self._newest[sender] for sender in sorted(self._newest)], self._beats
        self._newest, self._beats = {}, []
        return heard, beats
