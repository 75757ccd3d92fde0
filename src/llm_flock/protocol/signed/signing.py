"""The signed side of one robot's agreement: who said it, whose plan it is, whose heart beats, and who gave the mission.

Claims on places are in `evidence`. Without keys none of this exists, and messages are as they were.
"""

from __future__ import annotations

from collections.abc import Sequence

from llm_flock.errors import MessageError
from llm_flock.protocol.messages.message import Message, MissionStamp, Provenance
from llm_flock.protocol.signed.certificates import (
    MOST_EPOCHS,
    OPERATOR,
    Authenticator,
    Authorization,
    Proofs,
    beat_statement,
    mission_statement,
    origin_statement,
    wrap,
)
from llm_flock.protocol.signed.evidence import Evidence

REMEMBERED_ORIGINS = 1024


class Signing:
    """Signatures other than those on places.

    Args:
        robot: own id.
        authenticator: signs and checks.
    """

    def __init__(self, robot: int, authenticator: Authenticator) -> None:
        self.evidence = Evidence(robot, authenticator)
        self._robot = robot
        self._authenticator = authenticator
        self._origins: dict[tuple[Provenance, str], bytes] = {}
        self._beats: dict[int, dict[int, bytes]] = {}
        self._order: Authorization | None = None

    def vouch(self, message: Message, proofs: Proofs, sender: int | None) -> None:
        """Check what a message says of its sender and of its plan's origin.

        Raises:
            MessageError: with reason `impostor`, `forged_origin` or `many_plans`.
        """
        if message.sender != sender:
            raise MessageError("impostor", f"robot {sender} speaks as robot {message.sender}")
        origin, plan = message.provenance, message.plan_digest
        if origin is None or plan is None:
            return
        if not origin.sequence <= origin.epoch <= MOST_EPOCHS:
            raise MessageError("many_plans", f"plan {origin.sequence} of robot {origin.proposer} in {origin.epoch}")
        if (origin, plan) in self._origins:
            return
        signature = proofs.origin or b""
        if not self._authenticator.check(origin.proposer, origin_statement(origin, plan), signature):
            raise MessageError("forged_origin", f"robot {origin.proposer} has not signed this plan")
        self._remember(origin, plan, signature)

    def propose(self, origin: Provenance, plan: str) -> None:
        """Sign a plan of one's own."""
        self._remember(origin, plan, self._authenticator.sign(origin_statement(origin, plan)))

    def _remember(self, origin: Provenance, plan: str, signature: bytes) -> None:
        if len(self._origins) >= REMEMBERED_ORIGINS:
            self._origins.clear()
        self._origins[origin, plan] = signature

    def check_order(self, stamp: MissionStamp, order: Authorization | None) -> None:
        """Check that the operator has given this mission.

        Raises:
            MessageError: with reason `no_order`.
        """
        statement = mission_statement(stamp)
        if order is None or not self._authenticator.check(OPERATOR, statement, order.signature):
            raise MessageError("no_order", f"the operator has not signed mission {stamp.counter}")
        self._order = order

    def beats(self, message: Message, proofs: Proofs, known: Sequence[int]) -> tuple[int, ...] | None:
        """The heartbeats of a message that are news and signed by whose they are; 0 stands for the others."""
        if message.beats is None:
            return None
        signatures = dict(enumerate(proofs.beats or ()))
        return tuple(
            count if count > known[j] and self._beat(j, count, signatures.get(j, b"")) else 0
            for j, count in enumerate(message.beats)
        )

    def _beat(self, robot: int, count: int, signature: bytes) -> bool:
        good = self.evidence.signed_by(robot, beat_statement(robot, count), signature)
        if good:
            self._beats.setdefault(robot, {})[count] = signature
        return good

    def say(self, payload: bytes, message: Message) -> bytes:
        """The payload with the certificates of what it says.

        Args:
            payload: the message as bytes.
            message: what these bytes say.
        """
        origin, plan, order = message.provenance, message.plan_digest, self._order
        proofs = self.evidence.prove(message)
        return wrap(
            payload,
            Proofs(
                claims=proofs.claims,
                grants=proofs.grants,
                words=proofs.words,
                offer=proofs.offer,
                origin=None if origin is None or plan is None else self._origins.get((origin, plan)),
                mission=None if message.mission_text is None or order is None else order.signature,
                beats=None if message.beats is None else self._signed_beats(message.beats),
            ),
        )

    def _signed_beats(self, beats: Sequence[int]) -> tuple[bytes, ...]:
        count = beats[self._robot]
        self._beats[self._robot] = {count: self._authenticator.sign(beat_statement(self._robot, count))}
        for j, count in enumerate(beats):
            known = self._beats.get(j, {})
            self._beats[j] = {k: signature for k, signature in known.items() if k >= count}
        return tuple(self._beats[j].get(count, b"") for j, count in enumerate(beats))
