"""Null parts: an agent of them is the paper's robot, which hears its neighbours and flies every answer as it is."""

from __future__ import annotations

import pytest
from driven_agent import LINE, PLAN, DrivenAgent, says
from toy_keys import ToyKeys

from llm_flock.agent import Agent
from llm_flock.errors import InputError
from llm_flock.events import CommRoundBegan, MoveTo, Note, Origin
from llm_flock.message import decode
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.planner import PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol._agreement.assignment import Claim, IndexAssignment, NearestAssignment
from llm_flock.protocol._agreement.consensus import InfluenceConsensus, NoConsensus
from llm_flock.protocol._agreement.medoid import MedoidConsensus
from llm_flock.protocol._membership.team import TeamMembership
from llm_flock.protocol._motion.leg import Leg
from llm_flock.protocol._parts import Checker, Membership, Observation, Parts, Safety, Situation
from llm_flock.protocol._verification.steps import Verdict
from llm_flock.runtime._config import RunConfig
from llm_flock.runtime._roster import parts_of
from llm_flock_swarm._signed.certificates import Proofs
from llm_flock_swarm._signed.channel import SignedChannel
from llm_flock_swarm._signed.parts import signed_parts

HERE, BESIDE = (40.0, 50.0), (41.0, 50.0)
ELSEWHERE = Plan.of([(x, y + 5.0) for x, y in PLAN.points])


def papers() -> Agent:
    return Agent(0, LINE, parts=Parts(consensus=InfluenceConsensus(), assignment=NearestAssignment()))


def test_an_agent_of_null_parts_keeps_its_plan_and_place() -> None:
    driven = DrivenAgent(Agent(0, LINE, parts=Parts()))
    driven.round(says(1, plan=ELSEWHERE, slot=0))
    assert driven.agent.plan == PLAN and driven.agent.claim.slot == 0


def test_robot_of_the_paper_flies_its_answer_near_another() -> None:
    driven = DrivenAgent(papers(), here=HERE)
    driven.begin({1: BESIDE})
    driven.comm_round()
    assert driven.end(StepAnswer(waypoint=BESIDE))[-1] == MoveTo(waypoint=BESIDE, proposed=BESIDE, origin=Origin.MODEL)


def test_the_papers_robot_holds_without_an_answer() -> None:
    driven = DrivenAgent(papers(), here=HERE)
    held, flown = driven.round()[-2:]
    assert isinstance(held, Note) and held.kind == "held"
    assert flown == MoveTo(waypoint=HERE, proposed=None, origin=Origin.HOLD)


def test_the_papers_messages_tell_no_heartbeats_and_no_positions() -> None:
    driven = DrivenAgent(papers())
    driven.begin({})
    (said,) = driven.agent.handle(CommRoundBegan())
    message = decode(said.payload, 3, 2)  # type: ignore[union-attr]
    assert message.plan == PLAN and message.beats is None and message.positions is None


def test_others_heartbeats_change_nothing_in_the_papers_robot() -> None:
    driven = DrivenAgent(papers())
    driven.begin({})
    driven.comm_round(says(1, (0, 9, 9), plan=PLAN, slot=1, positions={1: (1, HERE, ())}))
    assert driven.agent.claim.slot == 0 and not driven.agent.rejected


def test_robot_without_team_proposes_once_and_never_seeks() -> None:
    nobody, now = Membership(), Situation(LINE)
    now.position, now.sensed = HERE, {1: BESIDE}
    assert nobody.places(now) == 3
    now.plan = PLAN
    assert nobody.places(now) is None and nobody.seek(now) is None and nobody.wait(now) == HERE
    assert nobody.still(now) == () and nobody.positions(now) is None
    assert not nobody.beats and not nobody.lost


def test_without_membership_a_far_place_is_flown_to_straight() -> None:
    line = Mission(shape="line", n_robots=9)
    plan = Plan.of(line.ideal or ())
    now, before = Situation(line), Claim(slot=8)
    now.plan, now.claim, now.position = plan, before, plan.points[0]
    assert Membership().route(now) == (None, before, [])


def test_an_unverified_answer_is_used_as_it_is() -> None:
    checker, far = Checker(), StepAnswer(waypoint=(1e3, 1e3))
    asked = PlanQuestion(mission=LINE, robot=0, round=1, position=HERE, neighbors=())
    step = StepQuestion(mission=LINE, robot=0, round=1, position=HERE, neighbors=(), plan=PLAN, slot=0)
    answer = PlanAnswer(plan=ELSEWHERE, slot=0)
    assert checker.plan(asked, answer) is answer
    assert checker.objection(LINE, ELSEWHERE) is None and checker.plan_class(LINE, ELSEWHERE) == 0
    assert checker.judge(step, far) == Verdict(reason=None, fit=far)


def test_null_safety_asks_no_robot_to_make_way() -> None:
    safety = Safety()
    safety.begin_mission()
    assert safety.room(Observation(position=HERE, sensed={}), Leg(goal=BESIDE, stop=BESIDE, left=1.0)) == 0.0
    assert safety.course is None and safety.stay(Observation(position=HERE, sensed={1: BESIDE})).waypoint == HERE


@pytest.mark.parametrize("protocol", ["paper", "baseline"])
def test_the_papers_presets_have_null_parts(protocol: str) -> None:
    config = RunConfig.build(n_robots=3, shape="line", protocol=protocol)
    parts = parts_of(config, config.protocol.rules(), 0)
    assert [type(parts.membership), type(parts.safety), type(parts.verifier)] == [Membership, Safety, Checker]


@pytest.mark.parametrize(
    "other", [{}, {"protocol": "paper", "assignment": "auction"}, {"protocol": "paper", "gaps": "replan"}]
)
def test_other_rules_and_replanning_need_to_know_the_team(other: dict[str, str]) -> None:
    config = RunConfig.build(n_robots=3, shape="line", **other)
    assert isinstance(parts_of(config, config.protocol.rules(), 0).membership, TeamMembership)


def test_signatures_are_parts_and_keep_the_rules() -> None:
    plain = Parts(consensus=NoConsensus(), assignment=IndexAssignment())
    signed = signed_parts(plain, 0, LINE, ToyKeys(0))
    assert isinstance(signed.channel, SignedChannel) and signed.assignment.name == "index"
    assert type(signed.membership) is Membership and signed.consensus == plain.consensus


def test_a_team_with_keys_reports_no_positions() -> None:
    plain = Parts(membership=TeamMembership(0, LINE, gaps="replan"))
    signed = signed_parts(plain, 0, LINE, ToyKeys(0)).membership
    now = Situation(LINE)
    now.position = HERE
    assert plain.membership.report(now, greeting=True) == {0: (1, HERE, ())}
    assert signed.report(now, greeting=True) is None
    assert isinstance(signed, TeamMembership) and signed.gaps == "replan"


def test_heartbeats_are_passed_over_where_none_are_counted() -> None:
    driven = DrivenAgent(Agent(0, LINE, parts=signed_parts(Parts(), 0, LINE, ToyKeys(0))))
    channel = driven.agent._messaging.channel
    assert isinstance(channel, SignedChannel)
    message = decode(says(1, (0, 9, 9)), 3, 2)
    assert channel._verified_beats(message, Proofs()) is None


def test_keys_refuse_rules_that_compare_proposals_passed_on() -> None:
    with pytest.raises(InputError, match=r"consensus = 'medoid': expected .* in a team with keys"):
        signed_parts(Parts(consensus=MedoidConsensus()), 0, LINE, ToyKeys(0))
