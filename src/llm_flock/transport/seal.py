"""Where bytes are closed on their way out and opened on their way in: the place for signatures.

Everything that goes over the network passes `seal` at its sender and `open` at its receiver, and nothing else does.
"""

from __future__ import annotations

from typing import Protocol

from llm_flock.errors import MessageError

WORLD = -1
"""Sender of what the bodies and sensors say."""
OPERATOR = -2
"""Sender of missions."""

WATCHER = -3
"""Who only listens."""

_ID_BYTES = 2


class Seal(Protocol):
    """Closes what one sender says, and opens what others say."""

    def seal(self, payload: bytes, topic: str) -> bytes:
        """The bytes to send under a topic."""
        ...

    def open(self, sealed: bytes, topic: str) -> tuple[int, bytes]:
        """Who sent it under this topic (a robot's id, WORLD or OPERATOR), and what.

        Raises:
            MessageError: it is not to be believed; the reason is counted.
        """
        ...


class PlainSeal:
    """Says who sends, and proves nothing: for networks in which everybody is trusted.

    Args:
        sender: own id.
    """

    def __init__(self, sender: int) -> None:
        self._head = sender.to_bytes(_ID_BYTES, "big", signed=True)

    def seal(self, payload: bytes, topic: str) -> bytes:
        """The payload behind the sender's id."""
        return self._head + payload

    def open(self, sealed: bytes, topic: str) -> tuple[int, bytes]:
        """The sender's id, and the rest."""
        if len(sealed) < _ID_BYTES:
            raise MessageError("malformed", "no sender")
        return int.from_bytes(sealed[:_ID_BYTES], "big", signed=True), sealed[_ID_BYTES:]
