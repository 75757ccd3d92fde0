"""Places of the silent and under still bodies, and looks in vain."""

from __future__ import annotations

import pytest
from one_flight import PLAN, Flight, make, says

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.protocol.events import (
    AgreementEnded,
    Arrived,
    AskStep,
    Decided,
    MoveTo,
    Note,
)
from llm_flock.protocol.membership.search import LOOKS
from llm_flock.protocol.messages.message import BLOCKED, NO_OWNER, BidTable
from llm_flock.protocol.planning import StepAnswer

FAR: Point = (50.0, 90.0)


def test_the_place_of_who_falls_silent_is_free_with_a_raised_version() -> None:
    flight = Flight(make())
    theirs: BidTable = ((0, 0.0, NO_OWNER), (4, -1.0, 1), (0, 0.0, NO_OWNER))
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
    released: BidTable = ((3, 0.0, NO_OWNER), (0, 0.0, NO_OWNER), (0, 0.0, NO_OWNER))
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
    told: BidTable = ((0, -1.0, 1), (3, 0.0, BLOCKED), (0, -1.0, 2))
    flight = Flight(make(), here=PLAN.points[1])
    flight.round(says(1, plan=PLAN, table=told))
    flight.round()
    table = flight.agent.claim.table
    assert table is not None and flight.agent.claim.slot == 1 and table[1] == (4, 0.0, 0)


def test_a_place_on_which_somebody_stands_is_left_to_those_who_know_who_that_is() -> None:
    """A late joiner has not counted the silence yet: it takes the dead for alive."""
    told: BidTable = ((0, 0.0, NO_OWNER), (3, 0.0, BLOCKED), (0, 0.0, NO_OWNER))
    flight = Flight(make())
    body = {1: PLAN.points[1]}
    for _ in range(2):
        flight.round(says(2, (0, 7, 1), plan=PLAN, table=told), sensed=body)
        assert flight.agent.claim.table is not None and flight.agent.claim.table[1] == told[1]


def test_who_is_known_to_live_blocks_no_place() -> None:
    """Its counter goes on, so it will move off; two that wait beside a place would else keep it from each other."""
    told: BidTable = ((0, -1.0, 1), (3, 0.0, BLOCKED), (0, -1.0, 2))
    flight = Flight(make())
    beside = {1: (PLAN.points[1][0], PLAN.points[1][1] + 1.0)}
    owners: list[int] = []
    for beat in (7, 7, 8):
        flight.round(says(1, (0, beat, 1), plan=PLAN, table=told), sensed=beside)
        table = flight.agent.claim.table
        assert table is not None
        owners.append(table[1][2])
    assert owners == [BLOCKED, BLOCKED, NO_OWNER], "a counter that stands still may be that of the dead"


def test_a_robot_without_a_place_goes_to_see_whether_a_blocked_one_has_come_free() -> None:
    """Nobody else may be near enough, and in the others' tables the place is blocked for ever."""
    near = Mission(shape="line", n_robots=3, comm_range=15)
    told: BidTable = ((0, -1.0, 1), (3, 0.0, BLOCKED), (0, -1.0, 2))
    flight = Flight(make(mission=near), here=(40.0, 90.0))
    for _ in range(10):
        flight.begin()
        flight.comm_round(says(1, mission=near, plan=PLAN, table=told))
        effects = flight.agent.handle(AgreementEnded())
        if not isinstance(effects[-1], AskStep):
            break
        toward = StepAnswer(waypoint=effects[-1].question.goal)
        move = flight.agent.handle(Decided(toward))[-1]
        assert isinstance(move, MoveTo)
        flight.here = move.waypoint
        flight.agent.handle(Arrived())
        if flight.agent.claim.slot is not None:
            break
    assert flight.agent.claim.slot == 1


def test_places_out_of_sight_are_left_as_others_say() -> None:
    """The robot sees a body where it stands, and nothing of a place that is farther away than it senses."""
    near = Mission(shape="line", n_robots=3, comm_range=15)
    flight = Flight(make(mission=near))
    body = {1: (PLAN.points[1][0], PLAN.points[1][1] + 1.0)}
    told: BidTable = ((0, 0.0, NO_OWNER), (0, 0.0, NO_OWNER), (2, 0.0, BLOCKED))
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
    kept: BidTable = ((0, 0.0, NO_OWNER), (0, -1.0, 1), (0, 0.0, NO_OWNER))
    flight.round(says(1, (0, 2, 0), plan=PLAN, table=kept))
    notes: list[Note] = []
    for _ in range(120):
        flight.begin()
        flight.comm_round()
        effects = flight.agent.handle(AgreementEnded())
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
