"""The channel of a team with keys: proves senders, proposers of plans, heartbeats, and the operator's missions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import cast

import msgspec
import numpy as np

from llm_flock.errors import MessageError
from llm_flock.message import MAX_EPOCHS, Message, MissionStamp, Provenance, decode, without_plan
from llm_flock.mission import Mission
from llm_flock.protocol import Authorization, Channel, Inbound, Membership
from llm_flock_swarm._signed.certificates import (
    OPERATOR,
    Authenticator,
    Proofs,
    beat_statement,
    mission_statement,
    origin_statement,
    unwrap,
    wrap,
)
from llm_flock_swarm._signed.equivocations import Equivocations
from llm_flock_swarm._signed.evidence import Evidence

MAX_PENDING = 3  # most signed heartbeats of one robot that are kept: what is heard counts at the next exchange
REMEMBERED_ORIGINS = 1024  # most plan origins whose signatures are kept


class SignedChannel(Channel):
    """A channel that checks heartbeats only if `membership` says that they are news, and claims by `evidence`.

    If the team `replans`, a plan of a later epoch may replace a faultless one.
    """

    def __init__(
        self,
        robot: int,
        mission: Mission,
        authenticator: Authenticator,
        evidence: Evidence,
        membership: Membership,
        *,
        replans: bool,
    ) -> None:
        super().__init__(robot, mission)
        self._authenticator = authenticator
        self._evidence = evidence
        self._membership = membership
        self._most_epochs = MAX_EPOCHS if replans else 0
        self._equivocations = Equivocations(authenticator)
        self._origins: dict[tuple[Provenance, str], bytes] = {}
        self._beats: dict[int, dict[int, bytes]] = {}
        self._authorization: Authorization | None = None

    @property
    def rejected(self) -> Counter[str]:
        return self._evidence.rejected

    def open(self, payload: bytes, sender: int | None) -> Inbound:
        """Unwrap, decode and verify; more reasons are `impostor`, `forged_origin`, `many_plans` and `uncertified`."""
        content, proofs = unwrap(payload, self._n_robots, self._evidence.liars)
        message = decode(content, self._n_robots, self._dim)
        self._check_sender(message)
        if message.sender != sender:
            raise MessageError("impostor", f"robot {sender} speaks as robot {message.sender}")
        proofs = msgspec.structs.replace(proofs, origin=self._checked_origin(message, proofs))
        beats = self._verified_beats(message, proofs)
        return Inbound(
            message=msgspec.structs.replace(message, proofs=proofs),
            beats=None if beats is None else np.array(beats, dtype=np.int64),
            authorization=Authorization(counter=message.mission.counter, signature=proofs.mission or b""),
        )

    def _checked_origin(self, message: Message, proofs: Proofs) -> bytes | None:
        """The proposer's signature on the plan of a message, if it is about one."""
        origin, plan = message.provenance, message.plan_digest
        if origin is None or plan is None:
            return None
        if not origin.sequence <= origin.epoch <= self._most_epochs:
            raise MessageError("many_plans", f"plan {origin.sequence} of robot {origin.proposer} in {origin.epoch}")
        known = self._known_origin(origin, plan)
        if known is not None:
            return known
        signature = proofs.origin or b""
        if not self._authenticator.check(origin.proposer, origin_statement(origin, plan), signature):
            raise MessageError("forged_origin", f"robot {origin.proposer} has not signed this plan")
        self._remember(origin, plan, signature)
        return signature

    def _known_origin(self, origin: Provenance, plan: str) -> bytes | None:
        return self._equivocations.signature(origin, plan) or self._origins.get((origin, plan))

    def hold(self, heard: Sequence[Message]) -> list[Message]:
        """The messages without void plans. Origins of the other plans are kept, to be passed on in any case."""
        counting = [message for message in heard if self._consistent(message)]
        return [without_plan(message) if self._is_void(message.provenance) else message for message in counting]

    def _consistent(self, message: Message) -> bool:
        """Take note of who has proposed what; whether the message's own proofs of that hold."""
        proofs = cast("Proofs", message.proofs)
        try:
            self._equivocations.hear(message.mission, proofs)
        except MessageError as error:
            self._evidence.rejected[error.reason] += 1
            return False
        if message.provenance is not None and message.plan_digest is not None:
            self._equivocations.note(message.provenance, message.plan_digest, proofs.origin or b"")
        return True

    def _is_void(self, origin: Provenance | None) -> bool:
        if origin is None:
            return False
        return origin.proposer in self.void(origin.stamp)

    def void(self, mission: MissionStamp) -> frozenset[int]:
        return self._equivocations.void(mission)

    def _remember(self, origin: Provenance, plan: str, signature: bytes) -> None:
        if len(self._origins) >= REMEMBERED_ORIGINS:
            self._origins.clear()
        self._origins[origin, plan] = signature

    @property
    def order(self) -> bytes:
        return b"" if self._authorization is None else self._authorization.signature

    def check_mission(self, stamp: MissionStamp, authorization: Authorization | None) -> None:
        """A MessageError `no_order` unless the operator signed it."""
        statement = mission_statement(stamp)
        if authorization is None or not self._authenticator.check(OPERATOR, statement, authorization.signature):
            raise MessageError("no_order", f"the operator has not signed mission {stamp.counter}")

    def keep_order(self, authorization: Authorization | None) -> None:
        self._authorization = authorization

    def _verified_beats(self, message: Message, proofs: Proofs) -> tuple[int, ...] | None:
        """Each robot's heartbeat count if it is new and signed by that robot, else 0; None if none count here."""
        known_beats = self._membership.beats
        if message.beats is None or not known_beats:
            return None
        signatures, found = dict(enumerate(proofs.beats or ())), dict[int, tuple[int, bytes]]()
        for j, (count, known) in enumerate(zip(message.beats, known_beats, strict=True)):
            signature = signatures.get(j, b"")
            if count > known and signature:
                if not self._evidence.signed_by(j, beat_statement(j, count), signature):
                    raise MessageError("uncertified", f"robot {j} has not signed this heartbeat")
                found[j] = count, signature
        for j, (count, signature) in found.items():
            kept = {**self._beats.get(j, {}), count: signature}
            self._beats[j] = dict(sorted(kept.items())[-MAX_PENDING:])
        return tuple(found[j][0] if j in found else 0 for j in range(len(message.beats)))

    def seal(self, payload: bytes) -> bytes:
        """The message together with the certificates of everything in it; signs what is this robot's own."""
        message = decode(payload, self._n_robots, self._dim)
        authorization = self._authorization
        proofs = msgspec.structs.replace(
            self._evidence.prove(message),
            origin=self._origin_signature(message),
            equivocations=self._equivocations.proofs(message.mission),
            mission=None if message.mission_text is None or authorization is None else authorization.signature,
            beats=None if message.beats is None else self._signed_beats(message.beats),
        )
        return wrap(payload, proofs)

    def _origin_signature(self, message: Message) -> bytes | None:
        origin, plan = message.provenance, message.plan_digest
        if origin is None or plan is None:
            return None
        signature = self._known_origin(origin, plan)
        if signature is None and origin.proposer == self._robot:
            signature = self._authenticator.sign(origin_statement(origin, plan))
            self._remember(origin, plan, signature)
            self._equivocations.note(origin, plan, signature)
        return signature

    def _signed_beats(self, beats: Sequence[int]) -> tuple[bytes, ...]:
        count = beats[self._robot]
        self._beats[self._robot] = {count: self._authenticator.sign(beat_statement(self._robot, count))}
        for j, count in enumerate(beats):
            known = self._beats.get(j, {})
            self._beats[j] = {k: signature for k, signature in known.items() if k >= count}
        return tuple(self._beats[j].get(count, b"") for j, count in enumerate(beats))
