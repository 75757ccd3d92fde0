"""Proposers whose plans do not count: each has signed two plans for one epoch of the mission, and no honest robot does.

Otherwise they could keep a team from ever agreeing. Robots pass the proof on; all plans of these proposers for this
mission are void.
"""

from __future__ import annotations

from llm_flock.errors import MessageError
from llm_flock.message import MissionStamp, Provenance
from llm_flock_swarm._signed.certificates import Equivocation, Proofs, SignedPlan, Verifier, origin_statement


class Equivocations:
    """The plans that one robot has seen signed for one mission at a time, and the proofs that follow from them."""

    def __init__(self, verifier: Verifier) -> None:
        self._verifier = verifier
        self._mission: MissionStamp | None = None
        self._seen: dict[tuple[int, int], SignedPlan] = {}
        self._proofs: dict[int, Equivocation] = {}

    def void(self, mission: MissionStamp) -> frozenset[int]:
        """Robots whose plans for this mission do not count."""
        return frozenset(self._proofs) if mission == self._mission else frozenset()

    def proofs(self, mission: MissionStamp) -> tuple[Equivocation, ...]:
        return tuple(self._proofs.values()) if mission == self._mission else ()

    def note(self, origin: Provenance, plan: str, signature: bytes) -> None:
        """Take note of a plan's origin and its proposer's signature, which has been checked."""
        self._turn_to(origin.stamp)
        signed = SignedPlan(plan, origin.epoch, origin.degree, origin.sequence, signature)
        first = self._seen.setdefault((origin.proposer, origin.epoch), signed)
        if _exclude(first, signed):
            self._proofs.setdefault(origin.proposer, Equivocation(origin.proposer, (first, signed)))

    def signature(self, origin: Provenance, plan: str) -> bytes | None:
        """The proposer's signature on a plan of which note was taken, if it is the first for its epoch."""
        if origin.stamp != self._mission:
            return None
        first = self._seen.get((origin.proposer, origin.epoch))
        same = first is not None and _content(first) == (plan, origin.degree, origin.sequence)
        return first.signature if first is not None and same else None

    def hear(self, mission: MissionStamp, proofs: Proofs) -> None:
        """Check the proofs of a message, and keep the new ones. MessageError: a proof proves nothing."""
        self._turn_to(mission)
        for proof in proofs.equivocations:
            if proof.proposer in self._proofs:
                continue
            signed = all(self._is_signed(mission, proof.proposer, plan) for plan in proof.plans)
            if not (_exclude(*proof.plans) and signed):
                raise MessageError("uncertified", f"robot {proof.proposer} has not signed two plans")
            self._proofs[proof.proposer] = proof

    def _turn_to(self, mission: MissionStamp) -> None:
        if mission != self._mission:
            self._mission, self._seen, self._proofs = mission, {}, {}

    def _is_signed(self, mission: MissionStamp, proposer: int, signed: SignedPlan) -> bool:
        origin = Provenance(
            mission=mission.counter,
            mission_digest=mission.digest,
            epoch=signed.epoch,
            degree=signed.degree,
            proposer=proposer,
            sequence=signed.sequence,
        )
        return self._verifier.check(proposer, origin_statement(origin, signed.plan), signed.signature)


def _content(signed: SignedPlan) -> tuple[str, int, int]:
    return signed.plan, signed.degree, signed.sequence


def _exclude(one: SignedPlan, other: SignedPlan) -> bool:
    """Whether no honest robot signs both."""
    return one.epoch == other.epoch and _content(one) != _content(other)
