"""An assignment rule of a team with keys: only claims with certificates are merged, and own claims are signed."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

from msgspec.structs import replace

from llm_flock.protocol.agreement.assignment import AssignmentInput, AssignmentRule, Claim
from llm_flock.protocol.messages.message import UNSAID, BidTable, Message
from llm_flock.protocol.signed.certificates import Context, Proofs
from llm_flock.protocol.signed.evidence import Evidence

NO_PROOFS = Proofs()


class SignedAssignment:
    """Decorates an assignment rule: filters the tables it hears, and signs the claims it makes.

    Args:
        rule: the rule to decorate; its claims must carry a bid table.
        evidence: this robot's signatures about claims.
    """

    def __init__(self, rule: AssignmentRule, evidence: Evidence) -> None:
        self._rule = rule
        self._evidence = evidence

    @property
    def name(self) -> str:
        """Name of the decorated rule."""
        return self._rule.name

    def take(self, now: AssignmentInput) -> Claim:
        """First claim on a plan; evidence about another plan is dropped."""
        self._evidence.turn_to(Context(now.mission, now.plan.digest))
        return self._decide(self._rule.take, (UNSAID,) * len(now.plan), now)

    def update(self, claim: Claim, now: AssignmentInput) -> Claim:
        """The claim after a communication round."""
        return self._decide(lambda admitted: self._rule.update(claim, admitted), claim.table or (), now)

    def _decide(self, rule: Callable[[AssignmentInput], Claim], table: BidTable, now: AssignmentInput) -> Claim:
        evidence = self._evidence

        def admitted(message: Message) -> Message:
            return evidence.admit(message, cast("Proofs | None", message.proofs) or NO_PROOFS, table)

        heard = [admitted(message) for message in now.heard]
        if now.occupancy is not None:
            evidence.witness(table, now.occupancy)
        claim = rule(replace(now, heard=heard, granted=evidence.granted(table), precedence=evidence.precedence))
        evidence.attest(claim)
        return claim
