"""The signed side of one robot's talks: who said it, whose plan it is, whose heart beats, and who gave the mission.

Claims on places are in `ledger`. Without keys none of this exists, and messages are as they were.
"""

from __future__ import annotations

from collections.abc import Sequence

from llm_flock.errors import MessageError
from llm_flock.protocol.ledger import Ledger
from llm_flock.protocol.messages import Message, Pedigree, Stamp
from llm_flock.protocol.warrants import (
    MOST_EPOCHS,
    OPERATOR,
    Notary,
    Order,
    Proofs,
    beat_statement,
    mission_statement,
    origin_statement,
    wrap,
)

REMEMBERED_ORIGINS = 1024


class Signing:
    """Signatures other than those on places.

    Args:
        robot: own id.
        notary: signs and checks.
    """

    def __init__(self, robot: int, notary: Notary) -> None:
        self.ledger = Ledger(robot, notary)
        self._robot = robot
        self._notary = notary
        self._origins: dict[tuple[Pedigree, str], bytes] = {}
        self._beats: dict[int, dict[int, bytes]] = {}
        self._order: Order | None = None

    def vouch(self, message: Message, proofs: Proofs, sender: int | None) -> None:
        """Check what a message says of its sender and of its plan's origin.

        Raises:
            MessageError: with reason `impostor`, `forged_origin` or `many_plans`.
        """
        if message.sender != sender:
            raise MessageError("impostor", f"robot {sender} speaks as robot {message.sender}")
        origin, plan = message.pedigree, message.plan_digest
        if origin is None or plan is None:
            return
        if not origin.sequence <= origin.epoch <= MOST_EPOCHS:
            raise MessageError("many_plans", f"plan {origin.sequence} of robot {origin.proposer} in {origin.epoch}")
        if (origin, plan) in self._origins:
            return
        signature = proofs.origin or b""
        if not self._notary.check(origin.proposer, origin_statement(origin, plan), signature):
            raise MessageError("forged_origin", f"robot {origin.proposer} has not signed this plan")
        self._remember(origin, plan, signature)

    def propose(self, origin: Pedigree, plan: str) -> None:
        """Sign a plan of one's own."""
        self._remember(origin, plan, self._notary.sign(origin_statement(origin, plan)))

    def _remember(self, origin: Pedigree, plan: str, signature: bytes) -> None:
        if len(self._origins) >= REMEMBERED_ORIGINS:
            self._origins.clear()
        self._origins[origin, plan] = signature

    def check_order(self, stamp: Stamp, order: Order | None) -> None:
        """Check that the operator has given this mission.

        Raises:
            MessageError: with reason `no_order`.
        """
        statement = mission_statement(stamp)
        if order is None or not self._notary.check(OPERATOR, statement, order.signature):
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
        good = self.ledger.signed_by(robot, beat_statement(robot, count), signature)
        if good:
            self._beats.setdefault(robot, {})[count] = signature
        return good

    def say(self, payload: bytes, message: Message) -> bytes:
        """The payload with the warrants of what it says.

        Args:
            payload: the message as bytes.
            message: what these bytes say.
        """
        origin, plan, order = message.pedigree, message.plan_digest, self._order
        proofs = self.ledger.prove(message)
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
        self._beats[self._robot] = {count: self._notary.sign(beat_statement(self._robot, count))}
        for j, count in enumerate(beats):
            known = self._beats.get(j, {})
            self._beats[j] = {k: signature for k, signature in known.items() if k >= count}
        return tuple(self._beats[j].get(count, b"") for j, count in enumerate(beats))
