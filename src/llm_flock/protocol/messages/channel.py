"""Between the radio's bytes and the agreement: a message is verified and decoded once, then it is a value."""

from __future__ import annotations

from collections import Counter
from functools import lru_cache
from typing import Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from llm_flock.errors import MessageError
from llm_flock.protocol.messages.codec import decode
from llm_flock.protocol.messages.message import Message, MissionStamp


class Authorization(msgspec.Struct, frozen=True, kw_only=True):
    """The operator's signature under a mission.

    Attributes:
        counter: counter of the mission; higher than that of the mission before.
        signature: on the counter and the mission's digest.
    """

    counter: int
    signature: bytes


class Inbound(msgspec.Struct, frozen=True, kw_only=True):
    """One received message, verified and decoded.

    Attributes:
        message: what the sender says of its mission, plan, claim and the team's positions.
        beats: heartbeat counters of the team, shape (N,); None where the message has none.
        authorization: the operator's signature under the sender's mission (teams with keys only).
    """

    message: Message
    beats: NDArray[np.int64] | None
    authorization: Authorization | None = None

    @property
    def repeatable(self) -> bool:
        """Whether the same payload has nothing more to apply when it is received again in the same round."""
        return self.authorization is None and self.beats is None and self.message.positions is None


class Channel(Protocol):
    """Opens payloads that come in and seals those that go out."""

    @property
    def rejected(self) -> Counter[str]:
        """Parts of messages refused so far, by reason."""
        ...

    def open(self, payload: bytes, sender: int | None) -> Inbound:
        """Verify and decode a payload.

        Args:
            payload: the bytes received.
            sender: the robot that signed the transmission, where the transport knows.

        Raises:
            MessageError: the payload is not acceptable; its `reason` is one word.
        """
        ...

    def check_mission(self, stamp: MissionStamp, authorization: Authorization | None) -> None:
        """Check that a mission was given by the operator.

        Raises:
            MessageError: with reason `no_order`.
        """
        ...

    def seal(self, payload: bytes) -> bytes:
        """The encoded message with everything that receivers need to verify it."""
        ...


class PlainChannel:
    """The channel of a team without keys: every well-formed message of another robot is believed.

    Args:
        robot: own id.
        n_robots: team size N.
        dim: dimension d of space.
    """

    def __init__(self, robot: int, n_robots: int, dim: int) -> None:
        self._robot, self._n_robots, self._dim = robot, n_robots, dim

    @property
    def rejected(self) -> Counter[str]:
        """Nothing: such a message is refused as a whole."""
        return Counter()

    def open(self, payload: bytes, sender: int | None) -> Inbound:
        """Decode the payload; as in `Channel`."""
        return read(payload, self._robot, self._n_robots, self._dim)

    def check_mission(self, stamp: MissionStamp, authorization: Authorization | None) -> None:
        """Without keys any robot may pass on a mission."""

    def seal(self, payload: bytes) -> bytes:
        """The payload itself."""
        return payload


def read(payload: bytes, robot: int, n_robots: int, dim: int) -> Inbound:
    """Decode a message of another robot.

    Raises:
        MessageError: as `decode`, and with reason `own_id` if the sender claims to be this robot.
    """
    inbound = _decoded(payload, n_robots, dim)
    if inbound.message.sender == robot:
        raise MessageError("own_id", f"a message from outside claims to come from robot {robot}")
    return inbound


@lru_cache(maxsize=4096)
def _decoded(payload: bytes, n_robots: int, dim: int) -> Inbound:
    """A broadcast has many receivers: in a simulation its bytes are decoded once for all of them."""
    message = decode(payload, n_robots, dim)
    return Inbound(message=message, beats=None if message.beats is None else np.array(message.beats, dtype=np.int64))
