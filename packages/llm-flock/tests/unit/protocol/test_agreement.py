"""Agreement in flight: missions, plans named by digest, moving frames, and when rules are asked."""

from __future__ import annotations

import pytest
from driven_agent import LINE, PLAN, DrivenAgent, make, says
from whole_agent import whole_agent

from llm_flock.events import (
    AgreementEnded,
    Arrived,
    AskStep,
    CommRoundBegan,
    CommRoundEnded,
    Decided,
    Effect,
    MissionGiven,
    MoveTo,
    Note,
    Received,
    Sensed,
)
from llm_flock.message import NO_OWNER, UNSAID, BidTable, MissionStamp
from llm_flock.mission import Mission, mission_text
from llm_flock.plan import Plan
from llm_flock.planner import StepAnswer
from llm_flock.protocol._agreement.agreement import Agreement
from llm_flock.protocol._agreement.assignment import AssignmentInput, Claim
from llm_flock.protocol._agreement.auction import BOUND_ROUNDS, AuctionAssignment
from llm_flock.protocol._agreement.consensus import ProvenanceConsensus
from llm_flock.protocol._messages.dissemination import MAX_KNOWN_PLANS
from llm_flock.protocol._parts import Parts


def kinds(effects: list[Effect]) -> list[str]:
    return [effect.kind for effect in effects if isinstance(effect, Note)]


def test_mission_over_the_radio_voids_what_the_last_one_left() -> None:
    driven = DrivenAgent(make())
    driven.round()
    new = LINE.change(center=(60.0, 50.0), since=2)
    driven.begin()
    (note,) = driven.agent.handle(Received(says(1, mission=new, counter=1, text=mission_text(new))))
    assert isinstance(note, Note) and note.kind == "mission" and note.detail["counter"] == 1
    assert driven.agent.mission == new and driven.agent.plan is None and driven.agent.claim.slot is None
    driven.comm_round()
    effects = driven.end()
    assert kinds(effects) == ["held"], "this round it has no plan any more"
    driven.begin()
    assert driven.asked[-1].question.mission == new


@pytest.mark.parametrize("counter", [0, 1])
def test_mission_of_higher_stamp_holds_whichever_comes_first(counter: int) -> None:
    one, other = LINE.change(center=(60.0, 50.0)), LINE.change(center=(40.0, 50.0))
    low, high = sorted((one, other), key=lambda mission: mission.digest)
    stamps = {low.digest: counter + 1, high.digest: 1}  # a higher counter beats a higher digest
    wanted = low if counter else high
    for order in ((low, high), (high, low)):
        driven = DrivenAgent(make())
        driven.begin()
        for mission in order:
            driven.comm_round(says(1, mission=mission, counter=stamps[mission.digest], text=mission_text(mission)))
        assert driven.agent.mission == wanted


def test_a_plan_counts_only_with_its_mission() -> None:
    """A plan for a mission that was never said in full is not followed, and neither is one for a mission of before."""
    new = LINE.change(center=(60.0, 50.0))
    ahead = Plan.of(new.ideal or ())
    driven = DrivenAgent(make())
    driven.begin()
    driven.comm_round(says(1, mission=new, counter=1, plan=ahead))
    assert driven.agent.plan == PLAN and driven.agent.mission == LINE
    driven.end()
    driven.agent.handle(MissionGiven(mission=new, ordered_at=1))
    driven.begin()
    assert driven.agent.plan == PLAN, "the stand-in planner proposes it again"
    driven.comm_round(says(1, plan=ahead))
    assert driven.agent.plan == PLAN and driven.agent.provenance is not None
    assert driven.agent.provenance.mission_digest == new.digest
    driven.comm_round(says(2, mission=new, counter=1, plan=ahead, beats=None))
    assert driven.agent.plan == ahead


def test_plan_named_by_digest_is_followed_if_it_came_in_full() -> None:
    named = says(1, plan=PLAN, named_only=True)
    driven = DrivenAgent(make(), plan=Plan.of([[x, y + 1.0] for x, y in PLAN.points]))
    driven.begin()
    own = driven.agent.plan
    driven.comm_round(named)
    assert driven.agent.plan == own, "the plan itself was never sent"
    driven.comm_round(says(1, plan=PLAN))
    assert driven.agent.plan == PLAN
    wrong = says(2, plan=PLAN, named_only=True, places=2)
    before = driven.agent.claim
    driven.comm_round(wrong)
    assert driven.agent.plan == PLAN and driven.agent.claim == before


def test_a_flood_of_plans_costs_bounded_memory() -> None:
    driven = DrivenAgent(make())
    driven.begin()
    for k in range(MAX_KNOWN_PLANS + 1):
        driven.agent.handle(Received(says(1, plan=Plan.of([[float(k), 0.0], [0.0, 9.0], [9.0, 0.0]]))))
    first, last = (Plan.of([[float(k), 0.0], [0.0, 9.0], [9.0, 0.0]]) for k in (0, MAX_KNOWN_PLANS))
    driven.agent.handle(CommRoundEnded())
    assert driven.agent.plan == last
    driven.comm_round(says(2, plan=first, named_only=True))
    assert driven.agent.plan == last


def test_moving_mission_applies_in_its_own_frame_once_heard() -> None:
    """It has travelled since round 1; a spare robot's places are where the frame has them, not where they began."""
    moving = LINE.change(velocity=(2.0, 0.0), since=1)
    driven = DrivenAgent(make(), here=(50.0, 50.0))
    for _ in range(3):
        driven.round()
    driven.begin()
    travelled = Plan.of(LINE.ideal or ())
    driven.agent.handle(CommRoundBegan())
    driven.agent.handle(Received(says(1, mission=moving, counter=1, text=mission_text(moving), plan=travelled)))
    driven.agent.handle(CommRoundEnded())
    # At the beginning of round 4 the centre has made two of its steps: in its frame the robot is 4 units back.
    assert driven.agent.plan == travelled and driven.agent.claim.bids is not None
    distances = [-bid for bid in driven.agent.claim.bids]
    assert distances == pytest.approx([abs(x - 46.0) for x, _ in travelled.points])
    slot = driven.agent.claim.slot
    assert slot is not None
    assert driven.agent.goal == pytest.approx((travelled.points[slot][0] + 6.0, 50.0))


def test_a_plan_for_a_moving_centre_is_kept_in_its_frame() -> None:
    moving = Mission(shape="line", n_robots=3, comm_range=60, velocity=(2.0, 0.0))
    there = Plan.of(moving.at(1).ideal or ())
    driven = DrivenAgent(make(mission=moving), plan=there)
    driven.begin()
    assert driven.asked[0].question.mission.center == (52.0, 50.0)
    assert driven.agent.plan == PLAN


def test_committed_path_in_a_moving_frame_is_asked_about_once() -> None:
    moving = Mission(shape="line", n_robots=1, velocity=(2.0, 0.0))
    plan = Plan.of(moving.at(1).ideal or ())
    driven = DrivenAgent(make(mission=moving, on_event=True), here=(50.0, 50.0), plan=plan)
    asked = 0
    for number in range(1, 6):
        driven.begin()
        driven.comm_round()
        effects = driven.agent.handle(AgreementEnded())
        if isinstance(effects[-1], AskStep):
            asked += 1
            effects = driven.agent.handle(Decided(StepAnswer(waypoint=effects[-1].question.goal)))
        move = effects[-1]
        assert isinstance(move, MoveTo)
        assert move.waypoint == pytest.approx((50.0 + 2.0 * number, 50.0))
        driven.here = move.waypoint
        driven.agent.handle(Arrived())
    assert asked == 1


def test_places_of_earlier_missions_are_remembered() -> None:
    """The last first, and one of each group in radio range; those of a mission that travelled are nowhere now."""
    near = Mission(shape="line", n_robots=3, comm_range=21)
    east, travels = near.change(center=(85.0, 50.0)), near.change(velocity=(1.0, 0.0))
    agreement = Agreement(0, near, Parts())
    for count, mission in enumerate((east, travels, near), start=1):
        agreement.begin_mission(mission, MissionStamp(count, mission.digest))
    assert agreement.earlier == ((75.0, 50.0), (95.0, 50.0), (40.0, 50.0), (60.0, 50.0))


def test_a_repeated_message_counts_for_its_own_mission_only() -> None:
    driven = DrivenAgent(make())
    driven.begin()
    same = says(1, plan=PLAN)
    for _ in range(2):
        driven.comm_round(same)
    assert driven.agent.plan == PLAN
    driven.agent.handle(MissionGiven(mission=LINE.change(center=(60.0, 50.0), since=2), ordered_at=1))
    driven.comm_round(same)
    assert driven.agent.plan is None


class Counting:
    """An auction that counts its updates."""

    name = "counting"

    def __init__(self) -> None:
        self.asked = 0

    def take(self, now: AssignmentInput) -> Claim:
        return AuctionAssignment().take(now)

    def update(self, claim: Claim, now: AssignmentInput) -> Claim:
        self.asked += 1
        return AuctionAssignment().update(claim, now)


def counting() -> tuple[Counting, DrivenAgent]:
    rule = Counting()
    return rule, DrivenAgent(
        whole_agent(0, LINE, ProvenanceConsensus(), rule, shield_on=True, verify=False, time_out=2)
    )


def asked_by(driven: DrivenAgent, rule: Counting, *payloads: bytes) -> int:
    """How often a communication round with these payloads asks the rule."""
    before = rule.asked
    driven.comm_round(*payloads)
    return rule.asked - before


def test_rule_is_not_asked_again_with_unchanged_arguments() -> None:
    rule, driven = counting()
    driven.begin()
    same = says(1, plan=PLAN, table=(UNSAID, UNSAID, (0, -1.0, 1)))
    assert [asked_by(driven, rule, same) for _ in range(4)] == [1, 1, 0, 0], "its claim changed in the first"
    assert asked_by(driven, rule) == 1, "robot 1 was not heard"
    assert asked_by(driven, rule) == 0
    assert asked_by(driven, rule, same) == 1, "robot 1 was heard again"
    driven.end()
    driven.begin()
    assert asked_by(driven, rule, same) == 1, "another round"


def test_a_rule_is_asked_as_soon_as_an_argument_changes() -> None:
    rule, driven = counting()
    driven.begin({1: PLAN.points[2]})
    same = says(1, plan=PLAN)
    for _ in range(4):
        driven.comm_round(same)
    assert asked_by(driven, rule, same) == 0
    other = says(1, plan=PLAN, table=(UNSAID, UNSAID, (0, -1.0, 1)))
    assert asked_by(driven, rule, other) == 1, "another claim of robot 1"
    for _ in range(2):
        driven.comm_round(other)
    assert asked_by(driven, rule, other) == 0
    assert asked_by(driven, rule, other, says(2, plan=PLAN)) == 1, "another robot"
    for _ in range(2):
        driven.comm_round(other)
    assert asked_by(driven, rule, other) == 0
    driven.agent.handle(Sensed(position=(30.0, 50.0), degree=1, sensed={1: PLAN.points[2]}, observed=()))
    assert asked_by(driven, rule, other) == 1, "another position"
    for _ in range(2):
        driven.comm_round(other)
    assert asked_by(driven, rule, other) == 0
    driven.agent.handle(Sensed(position=(30.0, 50.0), degree=1, sensed={1: (40.0, 50.0)}, observed=()))
    assert asked_by(driven, rule, other) == 1, "a sensed robot has moved"


def test_rule_is_asked_again_once_its_occupancy_is_used_up() -> None:
    rule, driven = counting()
    for _ in range(3):
        driven.round()
    driven.begin()
    assert [asked_by(driven, rule) for _ in range(4)] == [1, 1, 0, 0]


def test_rule_is_asked_each_communication_round_of_an_offer() -> None:
    """The offer expires after a number of communication rounds, with any messages."""
    rule, driven = counting()
    table: BidTable = ((1, -1.0, 1), (1, -1.0, 0), (0, 0.0, NO_OWNER))
    driven.begin({1: PLAN.points[1]})
    message = says(1, plan=PLAN, table=table, slot=0)
    bound: list[int] = []
    for _ in range(BOUND_ROUNDS + 1):
        assert asked_by(driven, rule, message) == 1
        assert driven.agent.claim.slot == 1 and driven.agent.claim.offer is not None
        bound.append(driven.agent.claim.bound)
    assert bound == [4, 3, 2, 1, 4], "it expires, and is made again"
