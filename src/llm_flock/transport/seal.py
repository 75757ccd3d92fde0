"""Seals payloads before they are sent and opens them on arrival: the place for signatures.

Everything that goes over the network passes `seal` at its sender and `open` at its receiver.
"""

from __future__ import annotations

from typing import Protocol

from llm_flock.errors import MessageError

_ID_BYTES = 2


class Seal(Protocol):
    """Seals what one member sends, and opens what others send."""

    def seal(self, payload: bytes, topic: str) -> bytes:
        """The bytes to send under a topic."""
        ...

    def open(self, sealed: bytes, topic: str) -> tuple[int, bytes]:
        """The member that sent it under this topic, and the payload.

        Raises:
            MessageError: it cannot be trusted; the reason is counted.
        """
        ...


class PlainSeal:
    """Names the sender without proof: for networks on which every process is trusted."""

    def __init__(self, sender: int) -> None:
        self._head = sender.to_bytes(_ID_BYTES, "big", signed=True)

    def seal(self, payload: bytes, topic: str) -> bytes:
        """The sender's id, then the payload."""
        return self._head + payload

    def open(self, sealed: bytes, topic: str) -> tuple[int, bytes]:
        """The sender's id, and the payload."""
        if len(sealed) < _ID_BYTES:
            raise MessageError("malformed", "no sender")
        return int.from_bytes(sealed[:_ID_BYTES], "big", signed=True), sealed[_ID_BYTES:]
