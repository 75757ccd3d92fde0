"""Proposers whose plans do not count: each has signed two plans for the mission that exclude each other.

Of two plans the one of higher key wins, so who proposes plan after plan could keep a team from agreeing for ever. An
honest robot signs one plan for an epoch; and where a team does not replan, it proposes the same points in every epoch.
Two that break this are a proof against their proposer, which every robot checks by itself and passes on: all plans of
that robot for this mission are void, also one that is in force.
"""

from __future__ import annotations

from llm_flock.errors import MessageError
from llm_flock.protocol.messages.message import MissionStamp, Provenance
from llm_flock.protocol.signed.certificates import Equivocation, Proofs, SignedPlan, Verifier, origin_statement


class Equivocations:
    """The plans that one robot has seen signed for one mission at a time, and the proofs that follow from them.

    If the team `replans`, a robot may propose other points in a later epoch.
    """

    def __init__(self, verifier: Verifier, *, replans: bool) -> None:
        self._verifier = verifier
        self._replans = replans
        self._mission: MissionStamp | None = None
        self._seen: dict[int, dict[int, SignedPlan]] = {}
        self._proofs: dict[int, Equivocation] = {}

    def void(self, mission: MissionStamp) -> frozenset[int]:
        """Robots whose plans for this mission do not count."""
        return frozenset(self._proofs) if mission == self._mission else frozenset()

    def proofs(self, mission: MissionStamp) -> tuple[Equivocation, ...]:
        """A proof against each of them."""
        return tuple(self._proofs.values()) if mission == self._mission else ()

    def note(self, origin: Provenance, plan: str, signature: bytes) -> None:
        """Take note of a plan's origin and its proposer's signature, which has been checked."""
        self._turn_to(MissionStamp(origin.mission, origin.mission_digest))
        signed = SignedPlan(plan, origin.epoch, origin.neighbors, origin.sequence, signature)
        seen = self._seen.setdefault(origin.proposer, {})
        for other in seen.values():
            if self._exclude(other, signed):
                self._proofs.setdefault(origin.proposer, Equivocation(origin.proposer, (other, signed)))
        seen.setdefault(origin.epoch, signed)

    def hear(self, mission: MissionStamp, proofs: Proofs) -> None:
        """Check the proofs that somebody shows, and keep those that are news.

        Raises:
            MessageError: with reason `uncertified` for the first that proves nothing: nobody honest passes it on.
        """
        self._turn_to(mission)
        for proof in proofs.equivocations:
            if proof.proposer in self._proofs:
                continue
            signed = all(self._signed(mission, proof.proposer, plan) for plan in proof.plans)
            if not (self._exclude(*proof.plans) and signed):
                raise MessageError("uncertified", f"robot {proof.proposer} has not signed two plans")
            self._proofs[proof.proposer] = proof

    def _turn_to(self, mission: MissionStamp) -> None:
        if mission != self._mission:
            self._mission, self._seen, self._proofs = mission, {}, {}

    def _exclude(self, one: SignedPlan, other: SignedPlan) -> bool:
        """Whether no honest robot signs both."""
        content = (one.plan, one.neighbors, one.sequence) != (other.plan, other.neighbors, other.sequence)
        return content if one.epoch == other.epoch else not self._replans and one.plan != other.plan

    def _signed(self, mission: MissionStamp, proposer: int, signed: SignedPlan) -> bool:
        origin = Provenance(
            mission=mission.counter,
            mission_digest=mission.digest,
            epoch=signed.epoch,
            neighbors=signed.neighbors,
            proposer=proposer,
            sequence=signed.sequence,
        )
        return self._verifier.check(proposer, origin_statement(origin, signed.plan), signed.signature)
