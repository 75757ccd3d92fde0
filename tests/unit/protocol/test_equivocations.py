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
from llm_flock.mission import Mission
from llm_flock.protocol.events import (
    AgreementEnded,
    Arrived,
    Broadcast,
    CommRoundBegan,
    CommRoundEnded,
    Decided,
    Planned,
)
from llm_flock.protocol.messages.message import MOST_EPOCHS, MissionStamp, Provenance
from llm_flock.protocol.planning import NoAnswer, PlanAnswer
from llm_flock.protocol.signed.certificates import (
    Equivocation,
    Proofs,
    SignedPlan,
    max_signed_bytes,
    origin_statement,
    unwrap,
    wrap,
)
from llm_flock.protocol.signed.equivocations import Equivocations
from llm_flock.protocol.signed.guilt import guilt
from llm_flock.protocol.verification.validator import Validator

N = 5
MISSION = Mission(shape="circle", n_robots=N)
NO_ANSWER = NoAnswer(cause="answer", reason="none")
VALIDATOR = Validator(verify=True, shield_on=True)
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


def signed(proposer: int, plan: str, *, epoch: int = 0, neighbors: int = 1, by: int | None = None) -> SignedPlan:
    origin = Provenance(
        mission=0, mission_digest=MISSION.digest, epoch=epoch, neighbors=neighbors, proposer=proposer, sequence=0
    )
    keys = ToyKeys(proposer if by is None else by)
    return SignedPlan(plan, epoch, neighbors, 0, keys.sign(origin_statement(origin, plan)))


def shown(*proofs: Equivocation, replans: bool = False) -> Equivocations:
    known = Equivocations(ToyKeys(0), replans=replans)
    known.hear(STAMP, Proofs(equivocations=proofs))
    return known


def test_plan_after_plan_ends_with_the_second(team: SignedTeam, liar: Liar) -> None:
    before = team.agents[0].plan
    team.fly(1, lambda: [plan_of(liar, 3)])
    assert {agent.plan for agent in team.agents} == {good_plan(MISSION, 3)}, "one plan is everybody's right"
    for angle in range(4, 9):
        team.fly(2, lambda angle=angle: [plan_of(liar, angle)])
        assert {agent.plan for agent in team.agents} == {before}, "proposed again, without asking a model"
    assert team.settled()
    origin = team.agents[0].provenance
    assert origin is not None and (origin.epoch, origin.sequence, origin.proposer) == (1, 1, 2)
    void = [note.detail for note in team.notes if note.kind == "void_plan"]
    assert void == [{"plan": good_plan(MISSION, 3).digest, "proposer": N - 1}] * (N - 1)


@pytest.mark.parametrize("replans", [False, True])
def test_in_a_later_epoch_a_robot_proposes_the_same_points_unless_the_team_replans(replans: bool) -> None:
    first, same = signed(2, "a" * 16), signed(2, "a" * 16, epoch=1, neighbors=2)
    other = signed(2, "b" * 16, epoch=1)
    with pytest.raises(MessageError, match="uncertified"):
        shown(Equivocation(2, (first, same)), replans=replans)
    if replans:
        with pytest.raises(MessageError, match="uncertified"):
            shown(Equivocation(2, (first, other)), replans=True)
    else:
        assert shown(Equivocation(2, (first, other))).void(STAMP) == {2}


@pytest.mark.parametrize("more", [{"angle": 4}, {"angle": 3, "sequence": 1}])
def test_another_origin_is_another_plan(team: SignedTeam, liar: Liar, more: dict[str, int]) -> None:
    team.fly(1, lambda: [plan_of(liar, 3, epoch=1)])
    team.fly(1, lambda: [plan_of(liar, **{**more, "epoch": 1})])
    assert channel_of(team.agents[0]).void(STAMP) == {N - 1}


def test_the_proof_reaches_who_heard_neither(team: SignedTeam, liar: Liar) -> None:
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


def test_a_robot_that_has_forgotten_its_first_plan_withdraws_both() -> None:
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
    assert {agent.provenance.epoch for agent in team.agents if agent.provenance is not None} == {1}
    assert team.settled() and not fresh._agreement.may_propose


def test_later_epochs_need_as_many_proofs(team: SignedTeam, liar: Liar) -> None:
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
    assert heard.neighbors == team.agents[1].neighbors and channel_of(team.agents[0]).void(STAMP) == {N - 1}


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
    known = Equivocations(ToyKeys(0), replans=False)
    with pytest.raises(MessageError, match="uncertified"):
        known.hear(MissionStamp(1, MISSION.digest), Proofs(equivocations=(Equivocation(2, (first, second)),)))


def test_a_message_with_a_forged_proof_is_dropped_and_shows_guilt(team: SignedTeam, liar: Liar) -> None:
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
    assert judged(late, validator=Validator(verify=True, shield_on=True, any_size=True)) is None


def test_a_robot_that_takes_the_origin_of_another_with_its_own_points_signs_its_claims_anew() -> None:
    """Two models have answered with the same points. Claims signed about one origin prove nothing under the other."""
    team = SignedTeam(MISSION, line_up(N), gaps="replan")
    team.fly(2)
    liar, same = Liar(team), PlanAnswer(plan=good_plan(MISSION, 20), slot=0)
    for agent in team.agents[:2]:
        agent._agreement._own = same, "model"
    team.fly(1, lambda: [plan_of(liar, 3, epoch=1)])
    team.tell(1, plan_of(liar, 4, epoch=1), N - 1)
    team.agents[1].handle(CommRoundEnded())
    (said,) = team.agents[1].handle(CommRoundBegan())
    assert isinstance(said, Broadcast) and team.agents[1].plan == same.plan
    team.tell(0, said.payload, 1)
    team.agents[0].handle(CommRoundEnded())
    origin = team.agents[0].provenance
    assert team.agents[0].plan == same.plan and origin is not None and origin.proposer == 1
    (said,) = team.agents[0].handle(CommRoundBegan())
    assert isinstance(said, Broadcast)
    replanning = Validator(verify=True, shield_on=True, any_size=True)
    assert guilt(said.payload, 0, [MISSION], replanning, ToyKeys(0)) is None


def test_the_last_epoch_of_all_can_be_withdrawn_too() -> None:
    """In a team that replans, a liar signs two plans for the last epoch, after all have proposed in the one before."""
    team = SignedTeam(MISSION, line_up(N), gaps="replan")
    team.fly(2)
    liar = Liar(team)
    for agent in team.agents:
        agent._agreement._last_epoch = MOST_EPOCHS
    for angle in (3, 4):
        team.fly(1, lambda angle=angle: [plan_of(liar, angle, epoch=MOST_EPOCHS)])
    team.fly(3)
    assert {agent.provenance.epoch for agent in team.agents if agent.provenance is not None} == {MOST_EPOCHS + 1}
    assert team.settled()


def test_proofs_are_about_one_mission(team: SignedTeam, liar: Liar) -> None:
    team.fly(1, lambda: [plan_of(liar, 3)])
    team.fly(1, lambda: [plan_of(liar, 4)])
    channel = channel_of(team.agents[0])
    later = MissionStamp(9, MISSION.digest)
    assert channel.void(STAMP) == {N - 1} and channel.void(later) == frozenset()
    assert channel._equivocations.proofs(later) == ()
    channel._equivocations.hear(later, Proofs())
    assert channel.void(STAMP) == channel.void(later) == frozenset()


def test_a_robot_without_a_proposal_of_its_own_asks_its_model(team: SignedTeam, liar: Liar) -> None:
    agreement = team.agents[0]._agreement
    agreement._own = None
    for angle in (3, 4):
        team.tell(0, plan_of(liar, angle), N - 1)
        team.agents[0].handle(CommRoundEnded())
    assert agreement.plan is None and agreement.claim.slot is None and agreement.may_propose
    agreement.lack_plan(NO_ANSWER)
    team.comm_round()
    assert agreement.plan is not None, "it takes what it hears"
