"""The proposals of a whole team as one robot knows them, passed on for rules that compare them all."""

from __future__ import annotations

from collections.abc import Mapping

from llm_flock.message import MAX_PROPOSALS, Message, Proposal, Provenance
from llm_flock.plan import Plan


class Ballot:
    """The last proposal of each robot. Robots pass on some of them with each message, new ones first."""

    def __init__(self) -> None:
        self.known: Mapping[int, Message] = {}
        """The proposals as messages of their proposers, by id. A new object after each change."""
        self._new: list[int] = []
        self._turn = 0

    def take(self, origin: Provenance, plan: Plan, plan_class: int) -> None:
        """Take note of a proposal that passed the checks. It replaces an earlier one of its proposer."""
        before = self.known.get(origin.proposer)
        if before is not None and _age(before) >= (origin.epoch, origin.sequence, plan.digest):
            return
        said = Message(
            sender=origin.proposer,
            sequence=0,
            degree=origin.degree,
            provenance=origin,
            plan=plan,
            plan_class=plan_class,
        )
        self.known = {**self.known, origin.proposer: said}
        self._new = [*(j for j in self._new if j != origin.proposer), origin.proposer]

    def pass_on(self) -> tuple[Proposal, ...]:
        """The proposals for the next broadcast. An old one comes again when none is new, because messages get lost."""
        due, self._new = self._new[:MAX_PROPOSALS], self._new[MAX_PROPOSALS:]
        if self.known and not due:
            self._turn += 1
            due = [sorted(self.known)[self._turn % len(self.known)]]
        said = [(self.known[j].provenance, self.known[j].plan) for j in due]
        return tuple(Proposal(provenance=x, plan=plan) for x, plan in said if x is not None and plan is not None)


def _age(said: Message) -> tuple[int, int, str]:
    assert said.provenance is not None and said.plan is not None, "a proposal has both"
    return said.provenance.epoch, said.provenance.sequence, said.plan.digest
