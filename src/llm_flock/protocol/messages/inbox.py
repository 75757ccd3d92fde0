"""What a robot has heard since its last decision: the newest message of each sender, and everybody's heartbeats."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from llm_flock.protocol.messages.message import Message
from llm_flock.protocol.signed.certificates import Proofs

NO_PROOFS = Proofs()

REMEMBERED = 256
"""So many different messages are remembered in a round: whoever floods the radio may cost time, but not memory."""


class Inbox:
    """Messages of one communication round, and what their bytes mean as long as neighbours repeat them."""

    def __init__(self) -> None:
        self.proofs: dict[int, Proofs] = {}
        """What each sender's message was signed with."""
        self.beats: list[NDArray[np.int64]] = []
        """Heartbeats of this communication round, each of shape (N,)."""
        self._newest: dict[int, Message] = {}
        self._understood: dict[bytes, Message] = {}

    def begin_round(self) -> None:
        """Neighbours say something new once a round."""
        self._understood.clear()

    def void(self) -> None:
        """Another mission has come: nothing that was said before counts."""
        self._newest = {}
        self._understood.clear()

    def again(self, payload: bytes) -> Message | None:
        """What these bytes said in this round already; then that is taken down once more."""
        message = self._understood.get(payload)
        if message is not None:
            self.take(message, NO_PROOFS)
        return message

    def take(self, message: Message, proofs: Proofs, repeated_as: bytes | None = None) -> None:
        """Take down a message, unless a newer one of its sender has come.

        Args:
            message: what was said.
            proofs: what it was signed with.
            repeated_as: its bytes, where nothing in it is of a single use; they mean the same for the whole round.
        """
        if repeated_as is not None:
            if len(self._understood) >= REMEMBERED:
                self._understood.clear()
            self._understood[repeated_as] = message
        known = self._newest.get(message.sender)
        if known is None or message.sequence >= known.sequence:
            self._newest[message.sender] = message
            self.proofs[message.sender] = proofs

    def drain(self) -> tuple[list[Message], list[NDArray[np.int64]]]:
        """The newest message of each sender, in ascending order of senders, and the heartbeats; empties the inbox."""
        heard, beats = [self._newest[sender] for sender in sorted(self._newest)], self.beats
        self._newest, self.beats = {}, []
        return heard, beats
