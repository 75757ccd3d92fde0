"""A robot that signs two plans for one epoch: all its plans are void, and everybody can show why."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import msgspec
import pytest
from rounds import round_began
from signed_team import Liar, SignedTeam, channel_of, good_plan, line_up
from toy_keys import ToyKeys

from llm_flock.errors import MessageError
from llm_flock.events import (
    AgreementEnded,
    Arrived,
    AskPlan,
    Broadcast,
    CommRoundBegan,
    CommRoundEnded,
    Decided,
    Planned,
)
from llm_flock.message import MAX_EPOCHS, MissionStamp, Provenance
from llm_flock.mission import Mission
from llm_flock.planner import NoAnswer, PlanAnswer
from llm_flock.protocol._verification.validator import Validator
from llm_flock_swarm._signed.certificates import (
    Equivocation,
    Proofs,
    SignedPlan,
    max_signed_bytes,
    origin_statement,
    unwrap,
    wrap,
)
from llm_flock_swarm._signed.equivocations import Equivocations
from llm_flock_swarm._signed.guilt import guilt

N = 5
MISSION = Mission(shape="circle", n_robots=N)
NO_ANSWER = NoAnswer(cause="answer", reason="none")
VALIDATOR = Validator(shield_on=True)
STAMP = MissionStamp(0, MISSION.digest)


@pytest.fixture
def team() -> SignedTeam:
    team = SignedTeam(MISSION, line_up(N))
    team.fly(2)
    return team


@pytest.fixture
def liar(team: SignedTeam) -> Liar:
    return Liar(team)


def plan_of(liar: Liar, angle: int, **origin: int) -> bytes:
    return liar.says(plan=good_plan(MISSION, angle), provenance=liar.provenance(**origin), table=None)


def signed(proposer: int, plan: str, *, epoch: int = 0, degree: int = 1, by: int | None = None) -> SignedPlan:
    origin = Provenance(
        mission=0, mission_digest=MISSION.digest, epoch=epoch, degree=degree, proposer=proposer, sequence=0
    )
    keys = ToyKeys(proposer if by is None else by)
    return SignedPlan(plan, epoch, degree, 0, keys.sign(origin_statement(origin, plan)))


def shown(*proofs: Equivocation) -> Equivocations:
    known = Equivocations(ToyKeys(0))
    known.hear(STAMP, Proofs(equivocations=proofs))
    return known


def test_plan_after_plan_ends_with_the_second(team: SignedTeam, liar: Liar) -> None:
    before = [(agent.plan, agent.provenance, agent.claim.slot) for agent in team.agents]
    team.fly(1, lambda: [plan_of(liar, 3)])
    assert {agent.plan for agent in team.agents} == {good_plan(MISSION, 3)}, "one plan is everybody's right"
    team.begin()
    team.comm_round([plan_of(liar, 4)])
    assert [(agent.plan, agent.provenance, agent.claim.slot) for agent in team.agents] == before, "as it stood then"
    said = team.comm_round()
    assert [guilt(payload, j, [MISSION], VALIDATOR, ToyKeys(0)) for j, payload in enumerate(said)] == [None] * (N - 1)
    for angle in range(5, 9):
        team.comm_round([plan_of(liar, angle)])
        assert [(agent.plan, agent.provenance, agent.claim.slot) for agent in team.agents] == before
    void = [note.detail for note in team.notes if note.kind == "void_plan"]
    (digest,) = {plan.digest for plan, _, _ in before if plan is not None}
    assert void == [
        {"plan": good_plan(MISSION, 3).digest, "proposer": N - 1, "after": digest, "slot": slot}
        for _, _, slot in before
    ]


def test_liars_change_the_plan_twice_each() -> None:
    """Each shows its plan, the lowest first; then each signs a second one, the highest first."""
    mission = Mission(shape="circle", n_robots=8)
    team = SignedTeam(mission, line_up(8), liars=3, tolerated=3)
    team.fly(2)
    liars = {j: Liar(team, robot=j) for j in (5, 6, 7)}
    plans = [team.agents[0].plan]
    turns = [(5, 3), (6, 4), (7, 5), (7, 6), (6, 7), (5, 8), (5, 3), (6, 4), (7, 5), (7, 6)]
    team.begin()
    for j, angle in turns:
        plan = liars[j].says(plan=good_plan(mission, angle), provenance=liars[j].provenance(), table=None)
        for _ in range(5):
            team.comm_round(said_by=[(j, plan, None)])
        (now,) = {agent.plan for agent in team.agents}
        plans.append(now)
    first, *later = plans
    assert later == [good_plan(mission, k) for k in (3, 4, 5, 4, 3)] + [first] * 5
    assert team.settled()


def test_plans_for_two_epochs_are_no_proof() -> None:
    with pytest.raises(MessageError, match="uncertified"):
        shown(Equivocation(2, (signed(2, "a" * 16), signed(2, "b" * 16, epoch=1))))


@pytest.mark.parametrize("more", [{"angle": 4}, {"angle": 3, "sequence": 1}])
def test_another_origin_is_another_plan(more: dict[str, int]) -> None:
    team = SignedTeam(MISSION, line_up(N), gaps="replan")
    team.fly(2)
    liar = Liar(team)
    team.fly(1, lambda: [plan_of(liar, 3, epoch=1)])
    team.fly(1, lambda: [plan_of(liar, **{**more, "epoch": 1})])
    assert channel_of(team.agents[0]).void(STAMP) == {N - 1}


def test_proof_reaches_robots_that_heard_neither_plan(team: SignedTeam, liar: Liar) -> None:
    team.begin()
    for angle in (3, 4):
        team.comm_round(said_by=[(N - 1, plan_of(liar, angle), frozenset({0}))])
    for _ in range(N):
        team.comm_round()
    assert [channel_of(agent).void(STAMP) for agent in team.agents] == [{N - 1}] * (N - 1)
    assert {agent.plan for agent in team.agents} == {team.agents[-1].plan}
    (said, *_) = team.comm_round()
    (proof,) = unwrap(said, N)[1].equivocations
    assert shown(proof).void(STAMP) == {N - 1} and shown(proof).proofs(STAMP) == (proof,)
    assert len(said) < max_signed_bytes(N)


def test_robot_that_forgot_its_first_plan_withdraws_both() -> None:
    """Restarted out of contact, it has proposed another plan, and then hears of its own first one."""
    team = SignedTeam(MISSION, line_up(N))
    team.fly(2)
    (proposer,) = {agent.provenance.proposer for agent in team.agents if agent.provenance is not None}
    fresh = SignedTeam(MISSION, line_up(N)).agents[proposer]
    fresh.handle(round_began(3, (5.0, 5.0), {}))
    fresh.handle(Planned(PlanAnswer(plan=good_plan(MISSION, 20), slot=0)))
    fresh.handle(CommRoundBegan())
    noted = [fresh.handle(event) for event in (CommRoundEnded(), AgreementEnded(), Decided(NO_ANSWER), Arrived())]
    assert noted and fresh.plan == good_plan(MISSION, 20)
    team.agents[proposer] = fresh
    team.fly(6)
    assert [channel_of(agent).void(STAMP) for agent in team.agents] == [{proposer}] * (N - 1)
    assert team.settled() and not fresh._agreement.may_propose(N)


def test_later_epochs_are_for_teams_that_replan(team: SignedTeam, liar: Liar) -> None:
    before = team.agents[0].plan
    team.fly(1, lambda: [plan_of(liar, 3, epoch=1)])
    assert {agent.plan for agent in team.agents} == {before} and team.counts("many_plans") > 0
    replanning = SignedTeam(MISSION, line_up(N), gaps="replan")
    replanning.fly(1)
    replanning.fly(1, lambda: [plan_of(Liar(replanning), 3, epoch=1)])
    assert {agent.plan for agent in replanning.agents} == {good_plan(MISSION, 3)}


def test_void_plans_do_not_spread_from_those_who_do_not_know(team: SignedTeam, liar: Liar) -> None:
    """What else their messages say counts."""
    team.tell(1, plan_of(liar, 3), N - 1)
    team.agents[1].handle(CommRoundEnded())
    (said,) = team.agents[1].handle(CommRoundBegan())
    assert isinstance(said, Broadcast) and team.agents[1].plan == good_plan(MISSION, 3)
    for angle in (3, 4):
        team.tell(0, plan_of(liar, angle), N - 1)
        team.agents[0].handle(CommRoundEnded())
    before = team.agents[0].plan
    team.tell(0, said.payload, 1)
    (heard,) = team.agents[0]._messaging.drain()
    assert (heard.sender, heard.plan, heard.slot, heard.table) == (1, None, None, None) and before is not None
    assert heard.degree == team.agents[1].degree and channel_of(team.agents[0]).void(STAMP) == {N - 1}


def test_forged_proofs_are_no_proofs(team: SignedTeam, liar: Liar) -> None:
    first, second = signed(2, "a" * 16), signed(2, "b" * 16)
    assert shown(Equivocation(2, (first, second))).void(STAMP) == {2}
    forged: Sequence[Equivocation] = (
        Equivocation(2, (first, first)),
        Equivocation(2, (first, msgspec.structs.replace(first, signature=b"x"))),
        Equivocation(2, (first, signed(2, "b" * 16, by=3))),
        Equivocation(2, (signed(2, "b" * 16, by=3), first)),
        Equivocation(2, (msgspec.structs.replace(first, epoch=1), second)),
        Equivocation(3, (first, second)),
    )
    for proof in forged:
        with pytest.raises(MessageError, match="uncertified"):
            shown(proof)
    known = Equivocations(ToyKeys(0))
    with pytest.raises(MessageError, match="uncertified"):
        known.hear(MissionStamp(1, MISSION.digest), Proofs(equivocations=(Equivocation(2, (first, second)),)))


def test_message_with_a_forged_proof_is_dropped_showing_guilt(team: SignedTeam, liar: Liar) -> None:
    proof = Equivocation(2, (signed(2, "a" * 16), signed(2, "b" * 16, by=3)))
    content, proofs = unwrap(plan_of(liar, 3), N)
    lie = wrap(content, msgspec.structs.replace(proofs, equivocations=(proof,)))
    before = team.agents[0].plan
    team.fly(1, lambda: [lie])
    assert {agent.plan for agent in team.agents} == {before} and team.counts("uncertified") >= N - 1
    judged = partial(guilt, sender=N - 1, missions=[MISSION], verifier=ToyKeys(0))
    assert judged(lie, validator=VALIDATOR) == "uncertified"
    assert judged(plan_of(liar, 3), validator=VALIDATOR) is None
    late = plan_of(liar, 3, epoch=1)
    assert judged(late, validator=VALIDATOR) == "many_plans"
    assert judged(late, validator=Validator(shield_on=True, any_size=True)) is None


def test_claims_are_signed_about_the_origin_in_force(team: SignedTeam, liar: Liar) -> None:
    """A liar proposes the points of the plan in force, and then others: the same points come from two proposers."""
    plan, before = team.agents[0].plan, [agent.provenance for agent in team.agents]
    assert plan is not None
    team.fly(2, lambda: [liar.says(plan=plan, provenance=liar.provenance(), table=None)])
    origins = {agent.provenance for agent in team.agents}
    assert {origin.proposer for origin in origins if origin is not None} == {N - 1}
    for lies in ([], [plan_of(liar, 4)], []):
        sent = team.comm_round(lies)
        assert {guilt(payload, j, [MISSION], VALIDATOR, ToyKeys(0)) for j, payload in enumerate(sent)} == {None}
    assert [agent.provenance for agent in team.agents] == before and team.agents[0].plan == plan
    assert team.settled()


def test_the_last_epoch_of_all_can_be_withdrawn_too() -> None:
    """In a team that replans, a liar signs two plans for the last epoch: the plan before is in force again."""
    team = SignedTeam(MISSION, line_up(N), gaps="replan")
    team.fly(2)
    liar, before = Liar(team), team.agents[0].provenance
    team.fly(1, lambda: [plan_of(liar, 3, epoch=MAX_EPOCHS)])
    assert not any(agent._agreement.may_propose(N) for agent in team.agents)
    team.fly(1, lambda: [plan_of(liar, 4, epoch=MAX_EPOCHS)])
    assert {agent.provenance for agent in team.agents} == {before} and team.settled()
    assert all(agent._agreement.may_propose(N) for agent in team.agents)


def test_proofs_are_about_one_mission(team: SignedTeam, liar: Liar) -> None:
    team.fly(1, lambda: [plan_of(liar, 3)])
    team.fly(1, lambda: [plan_of(liar, 4)])
    channel = channel_of(team.agents[0])
    later = MissionStamp(9, MISSION.digest)
    assert channel.void(STAMP) == {N - 1} and channel.void(later) == frozenset()
    assert channel._equivocations.proofs(later) == ()
    channel._equivocations.hear(later, Proofs())
    assert channel.void(STAMP) == channel.void(later) == frozenset()


def test_robot_that_followed_no_other_plan_listens_then_asks(team: SignedTeam, liar: Liar) -> None:
    """It may have proposed one in a former life: a second one would void both."""
    team.begin()
    team.comm_round([plan_of(liar, 3)])
    fresh = SignedTeam(MISSION, line_up(N)).agents[0]
    team.end()
    team.agents[0] = fresh
    team.begin()
    team.comm_round()
    assert fresh.plan == good_plan(MISSION, 3)
    team.tell(0, plan_of(liar, 4), N - 1)
    fresh.handle(CommRoundEnded())
    assert fresh.plan is None and fresh.claim.slot is None and fresh._agreement.may_propose(N)
    for event in (AgreementEnded(), Arrived()):
        fresh.handle(event)
    near = {1: team.positions[1]}
    began = fresh.handle(round_began(9, team.positions[0], near))
    assert not [effect for effect in began if isinstance(effect, AskPlan)], "others may have a plan that counts"
    fresh.handle(CommRoundEnded())
    for event in (AgreementEnded(), Arrived()):
        fresh.handle(event)
    began = fresh.handle(round_began(10, team.positions[0], near))
    assert [effect for effect in began if isinstance(effect, AskPlan)], "but no robot spoke"
