"""Talks in flight: missions, places under still bodies, plans remade, looks in vain, frames that travel."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.protocol.agent import Agent
from llm_flock.protocol.auction import AuctionAssignment
from llm_flock.protocol.consensus import PedigreeConsensus
from llm_flock.protocol.events import (
    Arrived,
    AskPlan,
    AskStep,
    Decided,
    Effect,
    MissionGiven,
    MoveTo,
    NegotiationEnded,
    Note,
    Planned,
    Received,
    RoundBegan,
    TickBegan,
    TickEnded,
)
from llm_flock.protocol.messages import BLOCKED, NO_OWNER, Message, Pedigree, Stamp, Table, encode
from llm_flock.protocol.negotiation import MOST_WAIT, REMAKE_PATIENCE, REMEMBERED_PLANS, Gaps
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, StepAnswer
from llm_flock.protocol.search import LOOKS
from llm_flock.protocol.speech import mission_text

LINE = Mission(shape="line", n_robots=3, comm_range=60)
PLAN = Plan.of(LINE.ideal or ())
FAR: Point = (50.0, 90.0)
SILENT = NoAnswer(cause="answer", reason="none")


def make(
    robot: int = 0, mission: Mission = LINE, *, gaps: Gaps = "report", on_event: bool = False, verify: bool = False
) -> Agent:
    return Agent(
        robot,
        mission,
        PedigreeConsensus(),
        AuctionAssignment(),
        shield_on=True,
        verify=verify,
        time_out=2,
        gaps=gaps,
        on_event=on_event,
    )


class Flight:
    """One agent, round by round; the others are what it is told."""

    def __init__(self, agent: Agent, here: Point = PLAN.points[0], plan: Plan = PLAN) -> None:
        self.agent, self.here, self.plan = agent, here, plan
        self.number = 0
        self.asked: list[AskPlan] = []

    def begin(self, sensed: Mapping[int, Point] | None = None) -> None:
        self.number += 1
        others = sensed or {}
        began = RoundBegan(
            round=self.number,
            position=self.here,
            neighbors=len(others),
            sensed=others,
            observed=tuple(others.values()),
        )
        for effect in self.agent.handle(began):
            if isinstance(effect, AskPlan):
                self.asked.append(effect)
                self.agent.handle(Planned(PlanAnswer(plan=self.plan, slot=0)))

    def tick(self, *payloads: bytes) -> list[Effect]:
        self.agent.handle(TickBegan())
        effects = [effect for payload in payloads for effect in self.agent.handle(Received(payload))]
        return [*effects, *self.agent.handle(TickEnded())]

    def end(self, answer: StepAnswer | NoAnswer = SILENT) -> list[Effect]:
        effects = self.agent.handle(NegotiationEnded())
        if isinstance(effects[-1], AskStep):
            effects = [*effects, *self.agent.handle(Decided(answer))]
        self.agent.handle(Arrived())
        return effects

    def round(self, *payloads: bytes, sensed: Mapping[int, Point] | None = None) -> list[Effect]:
        self.begin(sensed)
        return [*self.tick(*payloads), *self.end()]


def says(
    sender: int,
    beats: tuple[int, ...] | None = None,
    *,
    mission: Mission = LINE,
    counter: int = 0,
    plan: Plan | None = None,
    table: Table | None = None,
    text: str | None = None,
    named_only: bool = False,
    places: int = 0,
) -> bytes:
    origin = Pedigree(mission=counter, mission_digest=mission.digest, epoch=0, neighbors=0, proposer=sender, sequence=0)
    said = Message(
        sender=sender,
        sequence=0,
        neighbors=0,
        mission=Stamp(counter, mission.digest),
        mission_text=text,
        plan=None if named_only else plan,
        plan_digest=None if plan is None else plan.digest,
        places=places or (0 if plan is None else len(plan)),
        pedigree=None if plan is None else origin,
        table=table,
        beats=beats,
    )
    return encode(said)


def kinds(effects: list[Effect]) -> list[str]:
    return [effect.kind for effect in effects if isinstance(effect, Note)]


# ---------------------------------------------------------------- places of the silent and under still bodies


def test_the_place_of_who_falls_silent_is_free_with_a_raised_version() -> None:
    flight = Flight(make())
    theirs: Table = ((0, 0.0, NO_OWNER), (4, -1.0, 1), (0, 0.0, NO_OWNER))
    flight.round(says(1, (0, 2, 0), plan=PLAN, table=theirs))
    assert flight.agent.claim.table is not None and flight.agent.claim.table[1][2] == 1
    for number in range(3):
        flight.round(says(2, (0, 2, number + 2), plan=PLAN, table=((0, 0.0, NO_OWNER),) * 3))
    assert flight.agent.claim.table[1][:1] == (5,) and flight.agent.claim.table[1][2] == NO_OWNER


def test_who_was_taken_for_dead_takes_its_place_back() -> None:
    flight = Flight(make())
    flight.round()
    slot = flight.agent.claim.slot
    assert slot == 0
    released: Table = ((3, 0.0, NO_OWNER), (0, 0.0, NO_OWNER), (0, 0.0, NO_OWNER))
    flight.round(says(1, plan=PLAN, table=released))
    table = flight.agent.claim.table
    assert flight.agent.claim.slot == 0 and table is not None and (table[0][0], table[0][2]) == (4, 0)


def test_a_place_under_a_body_without_a_mind_is_nobodys_until_it_has_moved_off() -> None:
    flight = Flight(make())
    body = {1: (PLAN.points[1][0] + 1.0, PLAN.points[1][1])}
    flight.round(says(1, (0, 2, 0)), sensed=body)
    for _ in range(3):
        flight.round(sensed=body)
    table = flight.agent.claim.table
    assert table is not None and table[1][2] == BLOCKED
    again = table
    flight.round(sensed=body)
    assert flight.agent.claim.table == again, "once noted it stays as it is"
    flight.round(sensed={1: FAR})
    table = flight.agent.claim.table
    assert table is not None and table[1][2] == NO_OWNER and table[1][0] == again[1][0] + 1


def test_a_robot_that_begins_again_where_its_body_blocked_a_place_says_so() -> None:
    """Those who noted it may be out of sight by now, and it has never met a body itself."""
    told: Table = ((0, -1.0, 1), (3, 0.0, BLOCKED), (0, -1.0, 2))
    flight = Flight(make(), here=PLAN.points[1])
    flight.round(says(1, plan=PLAN, table=told))
    flight.round()
    table = flight.agent.claim.table
    assert table is not None and flight.agent.claim.slot == 1 and table[1] == (4, 0.0, 0)


def test_a_place_on_which_somebody_stands_is_left_to_those_who_know_who_that_is() -> None:
    """A late joiner has not counted the silence yet: it takes the dead for alive."""
    told: Table = ((0, 0.0, NO_OWNER), (3, 0.0, BLOCKED), (0, 0.0, NO_OWNER))
    flight = Flight(make())
    body = {1: PLAN.points[1]}
    for _ in range(2):
        flight.round(says(2, (0, 7, 1), plan=PLAN, table=told), sensed=body)
        assert flight.agent.claim.table is not None and flight.agent.claim.table[1] == told[1]


def test_places_out_of_sight_are_left_as_others_say() -> None:
    """The robot sees a body where it stands, and nothing of a place that is farther away than it senses."""
    near = Mission(shape="line", n_robots=3, comm_range=15)
    flight = Flight(make(mission=near))
    body = {1: (PLAN.points[1][0], PLAN.points[1][1] + 1.0)}
    told: Table = ((0, 0.0, NO_OWNER), (0, 0.0, NO_OWNER), (2, 0.0, BLOCKED))
    flight.round(says(1, (0, 2, 0), mission=near, plan=PLAN, table=told), sensed=body)
    for _ in range(3):
        flight.round(sensed=body)
    table = flight.agent.claim.table
    assert table is not None and [entry[2] for entry in table] == [0, BLOCKED, BLOCKED]


def test_a_place_that_was_looked_at_in_vain_is_a_gap_that_names_who_is_missing() -> None:
    """One of two others has been heard of and is silent, one never was: after enough looks a place stays empty.

    The silent one keeps its place: who hears nobody takes nobody's.
    """
    flight = Flight(make())
    kept: Table = ((0, 0.0, NO_OWNER), (0, -1.0, 1), (0, 0.0, NO_OWNER))
    flight.round(says(1, (0, 2, 0), plan=PLAN, table=kept))
    notes: list[Note] = []
    for _ in range(120):
        flight.begin()
        flight.tick()
        effects = flight.agent.handle(NegotiationEnded())
        notes += [effect for effect in effects if isinstance(effect, Note)]
        ask = effects[-1]
        assert isinstance(ask, AskStep)
        move = flight.agent.handle(Decided(StepAnswer(waypoint=ask.question.goal)))[-1]
        assert isinstance(move, MoveTo)
        flight.here = move.waypoint
        flight.agent.handle(Arrived())
    (gap,) = (note for note in notes if note.kind == "gap")
    assert gap.detail == {"slots": [2], "missing": [1, 2]}
    assert flight.here == pytest.approx(PLAN.points[0])
    table = flight.agent.claim.table
    assert table is not None and table[2][1] == LOOKS, "looks are counted in the table"


# ---------------------------------------------------------------- plans that are remade


@pytest.mark.parametrize(("robot", "waits"), [(0, 1), (2, 2)])
def test_who_is_alive_and_has_the_lowest_id_remakes_the_plan_first(robot: int, waits: int) -> None:
    """Robot 1 is silent, so robot 2 counts as the second."""
    flight = Flight(make(robot, gaps="remake"), here=PLAN.points[robot])
    other = 2 - robot
    count = 0
    while len(flight.asked) < 2 and count < 40:
        count += 1
        beats = tuple(count + 1 if k == other else 2 * int(k == 1) for k in range(3))
        flight.round(says(other, beats))
    assert flight.asked[1].question.mission.n_places == 2
    # Robot 1 is silent from round 4 on; then the plan must not fit for more than REMAKE_PATIENCE rounds and a rank.
    assert flight.number == 4 + REMAKE_PATIENCE + waits
    assert waits <= MOST_WAIT
    assert flight.agent.pedigree is not None and flight.agent.pedigree.epoch == 1


def test_who_sees_the_body_that_is_in_the_way_remakes_the_plan_at_once_and_is_told_of_it() -> None:
    flight = Flight(make(2, gaps="remake"), here=PLAN.points[2])
    body = {1: PLAN.points[1]}
    for number in range(1, 4 + REMAKE_PATIENCE + 1):
        assert len(flight.asked) <= 1
        flight.round(says(0, (number + 1, 2, 0)), sensed=body)
    assert len(flight.asked) == 2 and flight.asked[1].question.still == (PLAN.points[1],)


CROSS = Mission(shape="cross", n_robots=5, comm_range=60)


@pytest.mark.parametrize(("mission", "gaps"), [(LINE, "report"), (CROSS, "remake")])
def test_gaps_are_kept_where_they_are_to_be_reported_and_where_no_smaller_shape_exists(
    mission: Mission, gaps: Gaps
) -> None:
    """Robot 1 is heard of once; all others go on."""
    plan = Plan.of(mission.ideal or ())
    flight = Flight(make(mission=mission, gaps=gaps), here=plan.points[0], plan=plan)
    for number in range(1, 20):
        beats = (0, 2, *(number + 1 for _ in range(mission.n_robots - 2)))
        flight.round(says(2, beats, mission=mission))
    assert len(flight.asked) == 1 and flight.agent.plan == plan


def test_a_smaller_plan_is_followed_only_where_plans_are_remade() -> None:
    smaller = Plan.of(LINE.resized(2).ideal or ())
    origin = says(1, plan=smaller)
    choices: tuple[tuple[Gaps, bool], ...] = (("remake", True), ("report", False))
    for gaps, followed in choices:
        flight = Flight(make(gaps=gaps, verify=True))
        flight.begin()
        flight.tick(origin)
        assert (flight.agent.plan == smaller) is followed
    flight = Flight(make(gaps="remake", verify=True))
    flight.begin()
    flight.tick(says(1, plan=Plan.of([[50.0, 50.0], [90.0, 90.0]])))
    assert flight.agent.plan == PLAN and flight.agent.rejected["unverified_plan"] == 1


# ---------------------------------------------------------------- missions and names


def test_a_mission_over_the_radio_voids_what_belonged_to_the_one_before() -> None:
    flight = Flight(make())
    flight.round()
    new = LINE.change(center=(60.0, 50.0), since=2)
    flight.begin()
    (note,) = flight.agent.handle(Received(says(1, mission=new, counter=1, text=mission_text(new))))
    assert isinstance(note, Note) and note.kind == "mission" and note.detail["counter"] == 1
    assert flight.agent.mission == new and flight.agent.plan is None and flight.agent.claim.slot is None
    flight.tick()
    effects = flight.end()
    assert kinds(effects) == ["held"], "this round it has no plan any more"
    flight.begin()
    assert flight.asked[-1].question.mission == new


@pytest.mark.parametrize("counter", [0, 1])
def test_of_two_missions_the_higher_stamp_is_in_force_whichever_comes_first(counter: int) -> None:
    one, other = LINE.change(center=(60.0, 50.0)), LINE.change(center=(40.0, 50.0))
    low, high = sorted((one, other), key=lambda mission: mission.digest)
    stamps = {low.digest: counter + 1, high.digest: 1}  # a higher counter beats a higher digest
    wanted = low if counter else high
    for order in ((low, high), (high, low)):
        flight = Flight(make())
        flight.begin()
        for mission in order:
            flight.tick(says(1, mission=mission, counter=stamps[mission.digest], text=mission_text(mission)))
        assert flight.agent.mission == wanted


def test_a_plan_counts_only_with_its_mission() -> None:
    """A plan for a mission that was never said in full is not followed, and neither is one for a mission of before."""
    new = LINE.change(center=(60.0, 50.0))
    ahead = Plan.of(new.ideal or ())
    flight = Flight(make())
    flight.begin()
    flight.tick(says(1, mission=new, counter=1, plan=ahead))
    assert flight.agent.plan == PLAN and flight.agent.mission == LINE
    flight.end()
    flight.agent.handle(MissionGiven(mission=new))
    flight.begin()
    assert flight.agent.plan == PLAN, "the stand-in planner proposes it again"
    flight.tick(says(1, plan=ahead))
    assert flight.agent.plan == PLAN and flight.agent.pedigree is not None
    assert flight.agent.pedigree.mission_digest == new.digest
    flight.tick(says(2, mission=new, counter=1, plan=ahead, beats=None))
    assert flight.agent.plan == ahead


def test_a_plan_that_is_only_named_is_followed_if_it_was_said_in_full_before() -> None:
    named = says(1, plan=PLAN, named_only=True)
    flight = Flight(make(), plan=Plan.of([[x, y + 1.0] for x, y in PLAN.points]))
    flight.begin()
    own = flight.agent.plan
    flight.tick(named)
    assert flight.agent.plan == own, "nobody ever said which plan that is"
    flight.tick(says(1, plan=PLAN))
    assert flight.agent.plan == PLAN
    wrong = says(2, plan=PLAN, named_only=True, places=2)
    before = flight.agent.claim
    flight.tick(wrong)
    assert flight.agent.plan == PLAN and flight.agent.claim == before


def test_whoever_floods_the_radio_with_plans_does_not_fill_the_memory() -> None:
    flight = Flight(make())
    flight.begin()
    for k in range(REMEMBERED_PLANS + 1):
        flight.agent.handle(Received(says(1, plan=Plan.of([[float(k), 0.0], [0.0, 9.0], [9.0, 0.0]]))))
    first, last = (Plan.of([[float(k), 0.0], [0.0, 9.0], [9.0, 0.0]]) for k in (0, REMEMBERED_PLANS))
    flight.agent.handle(TickEnded())
    assert flight.agent.plan == last
    flight.tick(says(2, plan=first, named_only=True))
    assert flight.agent.plan == last


# ---------------------------------------------------------------- frames that travel


def test_a_moving_mission_heard_in_a_round_is_seen_from_its_own_frame_at_once() -> None:
    """It has travelled since round 1; a spare robot's places are where the frame has them, not where they began."""
    moving = LINE.change(velocity=(2.0, 0.0), since=1)
    flight = Flight(make(), here=(50.0, 50.0))
    for _ in range(3):
        flight.round()
    flight.begin()
    travelled = Plan.of(LINE.ideal or ())
    flight.agent.handle(TickBegan())
    flight.agent.handle(Received(says(1, mission=moving, counter=1, text=mission_text(moving), plan=travelled)))
    flight.agent.handle(TickEnded())
    # At the beginning of round 4 the centre has made two of its steps: in its frame the robot is 4 units back.
    assert flight.agent.plan == travelled and flight.agent.claim.bids is not None
    distances = [-bid for bid in flight.agent.claim.bids]
    assert distances == pytest.approx([abs(x - 46.0) for x, _ in travelled.points])
    slot = flight.agent.claim.slot
    assert slot is not None
    assert flight.agent.goal == pytest.approx((travelled.points[slot][0] + 6.0, 50.0))


def test_a_plan_for_a_moving_centre_is_kept_in_its_frame() -> None:
    moving = Mission(shape="line", n_robots=3, comm_range=60, velocity=(2.0, 0.0))
    there = Plan.of(moving.at(1).ideal or ())
    flight = Flight(make(mission=moving), plan=there)
    flight.begin()
    assert flight.asked[0].question.mission.center == (52.0, 50.0)
    assert flight.agent.plan == PLAN


def test_along_a_path_in_a_moving_frame_the_robot_asks_once_and_keeps_its_place() -> None:
    moving = Mission(shape="line", n_robots=1, velocity=(2.0, 0.0))
    plan = Plan.of(moving.at(1).ideal or ())
    flight = Flight(make(mission=moving, on_event=True), here=(50.0, 50.0), plan=plan)
    asked = 0
    for number in range(1, 6):
        flight.begin()
        flight.tick()
        effects = flight.agent.handle(NegotiationEnded())
        if isinstance(effects[-1], AskStep):
            asked += 1
            effects = flight.agent.handle(Decided(StepAnswer(waypoint=effects[-1].question.goal)))
        move = effects[-1]
        assert isinstance(move, MoveTo)
        assert move.waypoint == pytest.approx((50.0 + 2.0 * number, 50.0))
        flight.here = move.waypoint
        flight.agent.handle(Arrived())
    assert asked == 1
