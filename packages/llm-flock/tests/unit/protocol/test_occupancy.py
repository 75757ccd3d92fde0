"""Places of silent robots, places under still bodies, and searches in vain."""

from __future__ import annotations

import math

import pytest
from driven_agent import PLAN, DrivenAgent, make, says

from llm_flock.arrays import Point
from llm_flock.events import AgreementEnded, Arrived, AskStep, Decided, MoveTo, Note
from llm_flock.message import BLOCKED, NO_OWNER, BidTable
from llm_flock.mission import Mission
from llm_flock.planner import StepAnswer
from llm_flock.protocol._membership.search import LOOKS

FAR: Point = (50.0, 90.0)


def test_place_of_a_silent_robot_is_freed_with_raised_version() -> None:
    driven = DrivenAgent(make())
    theirs: BidTable = ((0, 0.0, NO_OWNER), (4, -1.0, 1), (0, 0.0, NO_OWNER))
    driven.round(says(1, (0, 2, 0), plan=PLAN, table=theirs))
    assert driven.agent.claim.table is not None and driven.agent.claim.table[1][2] == 1
    for number in range(3):
        driven.round(says(2, (0, 2, number + 2), plan=PLAN, table=((0, 0.0, NO_OWNER),) * 3))
    assert driven.agent.claim.table[1][:1] == (5,) and driven.agent.claim.table[1][2] == NO_OWNER


def test_a_robot_taken_for_dead_takes_its_place_back() -> None:
    driven = DrivenAgent(make())
    driven.round()
    slot = driven.agent.claim.slot
    assert slot == 0
    released: BidTable = ((3, 0.0, NO_OWNER), (0, 0.0, NO_OWNER), (0, 0.0, NO_OWNER))
    driven.round(says(1, plan=PLAN, table=released))
    table = driven.agent.claim.table
    assert driven.agent.claim.slot == 0 and table is not None and (table[0][0], table[0][2]) == (4, 0)


def test_place_under_a_silent_body_is_blocked_until_it_moves() -> None:
    driven = DrivenAgent(make())
    body = {1: (PLAN.points[1][0] + 1.0, PLAN.points[1][1])}
    driven.round(says(1, (0, 8, 0)), sensed=body)
    for _ in range(3):
        driven.round(sensed=body)
    table = driven.agent.claim.table
    assert table is not None and table[1][2] == NO_OWNER, "a robot that hears no other takes none for dead"
    driven.round(says(2, (0, 8, 4)), sensed=body)
    table = driven.agent.claim.table
    assert table is not None and table[1][2] == BLOCKED
    again = table
    driven.round(says(2, (0, 8, 8)), sensed=body)
    assert driven.agent.claim.table == again, "once noted it stays as it is"
    driven.round(sensed={1: FAR})
    table = driven.agent.claim.table
    assert table is not None and table[1][2] == NO_OWNER and table[1][0] == again[1][0] + 1


def test_restarted_robot_frees_the_place_its_own_body_blocked() -> None:
    """Those that noted it may be out of sight, and it has never met a body itself."""
    theirs: BidTable = ((0, -1.0, 1), (3, 0.0, BLOCKED), (0, -1.0, 2))
    driven = DrivenAgent(make(), here=PLAN.points[1])
    driven.round(says(1, plan=PLAN, table=theirs))
    driven.round()
    table = driven.agent.claim.table
    assert table is not None and driven.agent.claim.slot == 1 and table[1] == (4, 0.0, 0)


def test_place_under_an_unknown_body_is_left_to_others() -> None:
    """A late joiner has not counted the silence yet: it takes the dead for alive."""
    theirs: BidTable = ((0, 0.0, NO_OWNER), (3, 0.0, BLOCKED), (0, 0.0, NO_OWNER))
    driven = DrivenAgent(make())
    body = {1: PLAN.points[1]}
    for _ in range(2):
        driven.round(says(2, (0, 7, 1), plan=PLAN, table=theirs), sensed=body)
        assert driven.agent.claim.table is not None and driven.agent.claim.table[1] == theirs[1]


def test_a_living_robot_blocks_no_place() -> None:
    """Its counter goes on, so it will move off; two that wait beside a place would else keep it from each other."""
    theirs: BidTable = ((0, -1.0, 1), (3, 0.0, BLOCKED), (0, -1.0, 2))
    driven = DrivenAgent(make())
    beside = {1: (PLAN.points[1][0], PLAN.points[1][1] + 1.0)}
    owners: list[int] = []
    for beat in (7, 7, 8):
        driven.round(says(1, (0, beat, 1), plan=PLAN, table=theirs), sensed=beside)
        table = driven.agent.claim.table
        assert table is not None
        owners.append(table[1][2])
    assert owners == [BLOCKED, BLOCKED, NO_OWNER], "a counter that stands still may be that of the dead"


def test_robot_without_place_checks_if_a_blocked_one_is_free() -> None:
    """No other may be near enough, and in the others' tables the place stays blocked."""
    near = Mission(shape="line", n_robots=3, comm_range=15)
    theirs: BidTable = ((0, -1.0, 1), (3, 0.0, BLOCKED), (0, -1.0, 2))
    driven = DrivenAgent(make(mission=near), here=(40.0, 90.0))
    for _ in range(10):
        driven.begin()
        driven.comm_round(says(1, mission=near, plan=PLAN, table=theirs))
        effects = driven.agent.handle(AgreementEnded())
        if not isinstance(effects[-1], AskStep):
            break
        toward = StepAnswer(waypoint=effects[-1].question.goal)
        move = driven.agent.handle(Decided(toward))[-1]
        assert isinstance(move, MoveTo)
        driven.here = move.waypoint
        driven.agent.handle(Arrived())
        if driven.agent.claim.slot is not None:
            break
    assert driven.agent.claim.slot == 1


def test_places_out_of_sight_stay_as_in_the_tables_of_others() -> None:
    """The robot sees a body where it stands, and nothing of a place that is farther away than it senses."""
    near = Mission(shape="line", n_robots=3, comm_range=15)
    driven = DrivenAgent(make(mission=near))
    body = {1: (PLAN.points[1][0], PLAN.points[1][1] + 1.0)}
    theirs: BidTable = ((0, 0.0, NO_OWNER), (0, 0.0, NO_OWNER), (2, 0.0, BLOCKED))
    driven.round(says(1, (0, 2, 0), mission=near, plan=PLAN, table=theirs), sensed=body)
    for number in range(3):
        driven.round(says(2, (0, 2, 4 * number), mission=near), sensed=body)
    table = driven.agent.claim.table
    assert table is not None and [entry[2] for entry in table] == [0, BLOCKED, BLOCKED]


def test_place_searched_in_vain_is_a_gap_naming_missing_robots() -> None:
    """One of two others has been heard of and is silent, one never was: after enough looks a place stays empty.

    The silent one keeps its place: a robot that hears no other takes no place of others.
    """
    driven = DrivenAgent(make())
    kept: BidTable = ((0, 0.0, NO_OWNER), (0, -1.0, 1), (0, 0.0, NO_OWNER))
    driven.round(says(1, (0, 2, 0), plan=PLAN, table=kept))
    notes: list[Note] = []
    for _ in range(120):
        driven.begin()
        driven.comm_round()
        effects = driven.agent.handle(AgreementEnded())
        notes += [effect for effect in effects if isinstance(effect, Note)]
        move = effects[-1]
        if isinstance(move, AskStep):  # otherwise it is alone at its place, and goes to look for the others
            move = driven.agent.handle(Decided(StepAnswer(waypoint=move.question.goal)))[-1]
        assert isinstance(move, MoveTo)
        driven.here = move.waypoint
        driven.agent.handle(Arrived())
        if any(note.kind == "gap" for note in notes) and math.dist(driven.here, PLAN.points[0]) < 1e-6:
            break
    (gap,) = (note for note in notes if note.kind == "gap")
    assert gap.detail == {"slots": [2], "missing": [1, 2]}
    assert driven.here == pytest.approx(PLAN.points[0])
    table = driven.agent.claim.table
    assert table is not None and table[2][1] == LOOKS, "looks are counted in the table"


def test_silence_out_of_radio_contact_frees_or_blocks_nothing() -> None:
    """Places 10 apart, and a radio that reaches 5: a robot at its place hears no other, and is not dead."""
    short = Mission(shape="line", n_robots=3, comm_range=5, sense_range=15)
    driven = DrivenAgent(make(mission=short))
    theirs: BidTable = ((0, 0.0, NO_OWNER), (4, -1.0, 1), (0, 0.0, NO_OWNER))
    driven.round(says(1, (0, 8, 0), mission=short, plan=PLAN, table=theirs))
    for number in range(2, 6):
        driven.round(says(2, (0, 8, 4 * number), mission=short), sensed={1: PLAN.points[1]})
    assert driven.agent.claim.table is not None and driven.agent.claim.table[1] == theirs[1]
