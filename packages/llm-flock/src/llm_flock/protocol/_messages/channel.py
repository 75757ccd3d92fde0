"""The layer between the radio's bytes and the agreement: verifies and decodes each message once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import lru_cache

import msgspec
import numpy as np
from msgspec.structs import force_setattr, replace
from numpy.typing import NDArray

from llm_flock.errors import MessageError
from llm_flock.message import Authorization, Message, MissionStamp, decode
from llm_flock.mission import Mission
from llm_flock.plan import Plan


class Inbound(msgspec.Struct, frozen=True, kw_only=True):
    """One received message, verified and decoded, with the team's heartbeat counters, shape (N,), if it has any."""

    message: Message
    beats: NDArray[np.int64] | None
    authorization: Authorization | None = None
    _resolved: Message | None = None

    @property
    def repeatable(self) -> bool:
        """Whether the same payload has nothing more to apply when it is received again in the same round."""
        return self.authorization is None and self.beats is None and self.message.positions is None

    def resolve(self, plan: Plan, plan_class: int) -> Message:
        """The message with its plan, for all receivers here, without what was merged on receipt."""
        known = self._resolved
        if known is None or known.plan != plan or known.plan_class != plan_class:
            known = replace(
                self.message, plan=plan, plan_class=plan_class, beats=None, positions=None, proposals=None, votes=None
            )
            force_setattr(self, "_resolved", known)
        return known


class Channel:
    """Opens incoming payloads and seals outgoing ones. This channel believes every well-formed message."""

    def __init__(self, robot: int, mission: Mission) -> None:
        self._robot, self._n_robots, self._dim = robot, mission.n_robots, mission.dim

    @property
    def rejected(self) -> Counter[str]:
        """Number of parts of messages rejected so far, by reason."""
        return Counter()

    def open(self, payload: bytes, sender: int | None) -> Inbound:
        """Verify and decode a payload, signed by `sender` if known. Raises MessageError as `decode`, or `own_id`."""
        inbound = _decode(payload, self._n_robots, self._dim)
        self._check_sender(inbound.message)
        return inbound

    def _check_sender(self, message: Message) -> None:
        if message.sender == self._robot:
            raise MessageError("own_id", f"a message from outside claims to come from robot {self._robot}")

    @property
    def order(self) -> bytes:
        """The operator's signature on the mission in force; empty for the first one, and without keys."""
        return b""

    def hold(self, heard: Sequence[Message]) -> list[Message]:
        """The messages on which the next decision is made: without keys, all that were heard."""
        return list(heard)

    def void(self, mission: MissionStamp) -> frozenset[int]:
        """Robots whose plans for a mission do not count; without keys there are none."""
        return frozenset()

    def check_mission(self, stamp: MissionStamp, authorization: Authorization | None) -> None:
        """Check that the operator gave a mission. Without keys, any robot may pass one on."""

    def keep_order(self, authorization: Authorization | None) -> None:
        """Keep the order for the mission in force."""

    def seal(self, payload: bytes) -> bytes:
        """The encoded message with everything that receivers need to verify it."""
        return payload


@lru_cache(maxsize=256)
def _one_plan(plan: Plan) -> Plan:
    """One object for equal plans, which many robots pass on."""
    return plan


@lru_cache(maxsize=2**14)
def _one_claim(claim: tuple[int, int, float, int]) -> tuple[int, int, float, int]:
    """As `_one_plan`; no reader of claims minds the sign of a zero."""
    return claim


@lru_cache(maxsize=256)
def _decode(payload: bytes, n_robots: int, dim: int) -> Inbound:
    """Decode a broadcast; cached, as a simulation has many receivers of the same bytes."""
    message = decode(payload, n_robots, dim)
    if message.plan is not None:
        force_setattr(message, "plan", _one_plan(message.plan))
    if message.claims is not None:
        force_setattr(message, "claims", tuple(map(_one_claim, message.claims)))
    return Inbound(message=message, beats=None if message.beats is None else np.array(message.beats, dtype=np.int64))
