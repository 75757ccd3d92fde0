"""Conformance tests for consensus and assignment rules."""

from __future__ import annotations

import numpy as np

from llm_flock.message import Message, Provenance, claims_in, decode, encode, table_digest
from llm_flock.plan import Plan
from llm_flock.protocol._agreement.assignment import AssignmentInput, AssignmentRule, Claim
from llm_flock.protocol._agreement.consensus import ConsensusRule, Standing

DIGEST = "0" * 16


def random_plan(n: int, rng: np.random.Generator, dim: int = 2) -> Plan:
    """N random points in a 100-unit box, shape (n, dim)."""
    return Plan.of(rng.uniform(0, 100, (n, dim)).round(2).tolist())


def random_message(sender: int, n: int, plan: Plan | None, rng: np.random.Generator) -> Message:
    """A legal message of one robot, with a random influence and provenance."""

    def draw() -> int:
        return int(rng.integers(0, n))

    origin = None if plan is None else _origin(degree=draw(), proposer=draw())
    slot = None if plan is None or rng.random() < 0.2 else draw()
    return Message(sender=sender, sequence=0, degree=draw(), plan=plan, provenance=origin, slot=slot)


def _origin(degree: int, proposer: int) -> Provenance:
    return Provenance(mission=0, mission_digest=DIGEST, epoch=0, degree=degree, proposer=proposer, sequence=0)


def check_consensus_rule(rule: ConsensusRule, *, trials: int = 200, seed: int = 0) -> None:
    """Check that a consensus rule keeps the contract of `ConsensusRule`.

    A name; no choice among nothing; only messages that were heard and carry a plan are chosen; the same arguments
    give the same choice, in any order of the messages; choosing settles (hearing the chosen message alone
    again changes nothing more).
    """
    assert isinstance(name := getattr(rule, "name", None), str) and name, "a rule has a name"
    rng = np.random.default_rng(seed)
    for _ in range(trials):
        n = int(rng.integers(1, 8))
        plans = [random_plan(n, rng), random_plan(n, rng), None]
        me = int(rng.integers(0, n))
        mine = random_message(me, n, plans[int(rng.integers(0, 3))], rng)
        own = Standing(robot=me, plan=mine.plan, provenance=mine.provenance, degree=mine.degree)
        assert rule.choose(own, []) is None, f"{rule.name} chose although nothing was heard"
        heard = [random_message(j, n, plans[int(rng.integers(0, 3))], rng) for j in range(n) if j != me]
        choice = rule.choose(own, heard)
        assert rule.choose(own, heard) is choice, f"{rule.name} gives different choices for the same arguments"
        if choice is None:
            continue
        assert any(choice is message for message in heard), f"{rule.name} chose a message that was not heard"
        assert choice.plan is not None, f"{rule.name} chose a message without a plan"
        shuffled = [heard[int(k)] for k in rng.permutation(len(heard))]
        again = rule.choose(own, shuffled)
        assert again is not None and again.plan == choice.plan, f"{rule.name} depends on the order of messages"
        settled = Standing(robot=me, plan=choice.plan, provenance=choice.provenance, degree=own.degree)
        assert rule.choose(settled, [choice]) is None, f"{rule.name} adopts again what it just adopted"


def check_assignment_rule(rule: AssignmentRule, *, trials: int = 100, seed: int = 0) -> None:
    """Check that an assignment rule keeps the contract of `AssignmentRule`.

    A name; slots within the plan; the same arguments give the same claim; a claim survives the wire (its table fits
    a message); hearing nothing changes nothing; exchanging claims among all robots comes to rest.
    """
    assert isinstance(name := getattr(rule, "name", None), str) and name, "a rule has a name"
    rng = np.random.default_rng(seed)
    for _ in range(trials):
        _check_team(rule, int(rng.integers(1, 7)), rng)


def _check_team(rule: AssignmentRule, n: int, rng: np.random.Generator) -> None:
    """One team of n that all hear each other, on one random plan."""
    plan = random_plan(n, rng)
    places = [tuple(float(x) for x in row) for row in rng.uniform(0, 100, (n, 2))]
    chosen = [int(rng.integers(0, n)) for _ in range(n)]

    def moment(i: int, heard: list[Message]) -> AssignmentInput:
        return AssignmentInput(
            robot=i,
            position=places[i],
            plan=plan,
            spacing=10.0,
            chosen=chosen[i],
            adopted=i > 0,
            heard=heard,
            sensed={j: places[j] for j in range(n) if j != i},
        )

    claims = [rule.take(moment(i, [])) for i in range(n)]
    for i, claim in enumerate(claims):
        assert rule.take(moment(i, [])) == claim, f"{rule.name} gives different claims for the same arguments"
        _check_claim(rule, claim, plan)
        idle = rule.update(claim, moment(i, []))
        assert idle.slot == claim.slot, f"{rule.name} changes its claim without hearing anything"
    for _ in range(10 * n + 10):
        spoken = [_message_of(i, plan, claims[i], n) for i in range(n)]
        before = [(c.slot, c.table, c.offer) for c in claims]
        claims = [rule.update(claims[i], moment(i, [m for m in spoken if m.sender != i])) for i in range(n)]
        for claim in claims:
            _check_claim(rule, claim, plan)
        if before == [(c.slot, c.table, c.offer) for c in claims]:
            return
    raise AssertionError(f"{rule.name} does not come to rest among {n} robots that all hear each other")


def _check_claim(rule: AssignmentRule, claim: Claim, plan: Plan) -> None:
    assert claim.slot is None or 0 <= claim.slot < len(plan), f"{rule.name} claims slot {claim.slot} of {len(plan)}"


def _message_of(robot: int, plan: Plan, claim: Claim, n: int) -> Message:
    """The claim as others hear it, through the wire format."""
    table = claim.table
    message = Message(
        sender=robot,
        sequence=0,
        degree=0,
        plan=plan,
        provenance=_origin(degree=0, proposer=0),
        slot=claim.slot,
        claims=None if table is None else claims_in(table),
        table_digest=None if table is None else table_digest(table),
        offer=claim.offer,
    )
    return decode(encode(message), n, 2)
