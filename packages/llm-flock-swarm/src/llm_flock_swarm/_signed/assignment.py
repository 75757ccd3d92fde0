"""An assignment rule of a team with keys: only claims with certificates are merged, and own claims are signed."""

from __future__ import annotations

from typing import cast

from msgspec.structs import replace

from llm_flock.message import UNSAID, BidTable
from llm_flock.protocol import AssignmentInput, AssignmentRule, Claim
from llm_flock_swarm._signed.certificates import Context, Proofs
from llm_flock_swarm._signed.evidence import Evidence

NO_PROOFS = Proofs()


class SignedAssignment:
    """Decorates a rule whose claims carry a bid table: filters the tables it hears, and signs its claims."""

    def __init__(self, rule: AssignmentRule, evidence: Evidence) -> None:
        self._rule, self._evidence = rule, evidence

    @property
    def name(self) -> str:
        return self._rule.name

    def take(self, now: AssignmentInput) -> Claim:
        """First claim on a plan; evidence about another plan is dropped."""
        self._evidence.turn_to(_about(now))
        claim = self._rule.take(self._admit(now, (UNSAID,) * len(now.plan)))
        self._evidence.attest(claim)
        return claim

    def update(self, claim: Claim, now: AssignmentInput) -> Claim:
        """The claim after a communication round; a first one if the plan has come back under another origin."""
        if self._evidence.turn_to(_about(now)):
            return self.take(now)
        admitted = self._admit(now, claim.table or ())
        claim = self._permit(self._rule.update(self._permit(claim, now.robot), admitted), now.robot)
        self._evidence.attest(claim)
        return claim

    def _permit(self, claim: Claim, robot: int) -> Claim:
        if claim.table is None or not self._evidence.excluded:
            return claim
        slot = None if robot in self._evidence.excluded else claim.slot
        return replace(claim, slot=slot, table=self._evidence.without_excluded(claim.table))

    def _admit(self, now: AssignmentInput, table: BidTable) -> AssignmentInput:
        evidence = self._evidence
        heard = [
            evidence.admit(m, cast("Proofs | None", m.proofs) or NO_PROOFS, table)
            for m in now.heard
            if m.provenance == now.origin
        ]
        if now.occupancy is not None:
            evidence.witness(table, now.occupancy)
        return replace(
            now,
            heard=heard,
            granted=evidence.granted(table),
            precedence=evidence.precedence,
            draw=evidence.draw,
            freed=evidence.freed,
            exchanges=evidence.may_exchange(len(now.plan)),
        )


def _about(now: AssignmentInput) -> Context:
    return Context(now.mission, now.plan.digest, now.origin)
