"""Joint assignment of the robots in touch: what is reported, when a table is written, and which one wins."""

from __future__ import annotations

import math
from typing import Any

import pytest
from driven_team import DrivenTeam

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.protocol.agreement.assignment import AssignmentInput, Claim
from llm_flock.protocol.agreement.auction import AuctionAssignment, merge, rank, reclaimed
from llm_flock.protocol.events import Broadcast, CommRoundBegan
from llm_flock.protocol.membership.all_to_all import PATIENCE, VERSION, optimal_assignment
from llm_flock.protocol.membership.in_touch import DIGESTS, InTouch, placed
from llm_flock.protocol.membership.search import MANY
from llm_flock.protocol.messages.message import BLOCKED, LAST_ROUND, NO_OWNER, UNSAID, BidTable, PositionReport, decode
from llm_flock.protocol.plan import Plan

N = 4
MISSION = Mission(shape="line", n_robots=N, center=(15.0, 0.0), arena=((-100, -100), (100, 100)))
ROW = Plan.of([[10.0 * k, 0.0] for k in range(N)])
EMPTY: BidTable = (UNSAID,) * N


def at(*places: Point, round_number: int = 1) -> dict[int, PositionReport]:
    return {robot: (round_number, place, ()) for robot, place in enumerate(places)}


def knowing(*places: Point, rounds: int = 1) -> InTouch:
    """Robot 0, which has heard of the first robots in its first round."""
    in_touch = InTouch(0, N)
    in_touch.begin_round()
    in_touch.hear(at(*places))
    for _ in range(rounds - 1):
        in_touch.begin_round()
    return in_touch


def owners(table: BidTable) -> list[int]:
    return [owner for _, _, owner in table]


def test_reports_are_passed_on_once_and_the_own_one_is_new_in_each_round() -> None:
    in_touch = InTouch(0, N)
    in_touch.begin_round()
    assert in_touch.report((1.234, 5.0), EMPTY, greeting=True) == {0: (1, (1.23, 5.0), ())}
    in_touch.hear({2: (7, (9.0, 9.0), ())})
    assert in_touch.report((1.234, 5.0), EMPTY, greeting=False) == {2: (7, (9.0, 9.0), ())}
    in_touch.hear({2: (6, (0.0, 0.0), ())})
    assert in_touch.report((1.234, 5.0), EMPTY, greeting=False) is None, "older than what is known"
    in_touch.begin_round()
    everything = {0: (2, (2.0, 5.0), ()), 2: (7, (9.0, 9.0), ())}
    assert in_touch.report((2.0, 5.0), EMPTY, greeting=True) == everything, "neighbours come and go between rounds"


def test_a_restarted_robot_counts_on_from_its_former_reports() -> None:
    in_touch = InTouch(0, N)
    in_touch.begin_round()
    in_touch.hear({0: (30, (9.0, 9.0), ())})
    assert (in_touch.report((1.0, 1.0), EMPTY, greeting=True) or {})[0] == (31, (1.0, 1.0), ())
    in_touch.hear({0: (LAST_ROUND, (9.0, 9.0), ())})
    assert (in_touch.report((1.0, 1.0), EMPTY, greeting=True) or {})[0] == (LAST_ROUND, (9.0, 9.0), ())


def test_nothing_is_reported_once_all_are_placed_or_nobody_new_has_come_for_long() -> None:
    everybody: BidTable = ((N * DIGESTS * VERSION, 0.0, 0),) * N
    in_touch = knowing((0.0, 0.0), (5.0, 0.0))
    assert in_touch.report((0.0, 0.0), everybody, greeting=True) is None
    assert in_touch.report((0.0, 0.0), EMPTY, greeting=False) is None, "old news are not told later"
    for _ in range(PATIENCE):
        in_touch.begin_round()
        in_touch.hear(at((0.0, 0.0), (5.0, 1.0), round_number=9))
    assert in_touch.collecting
    in_touch.begin_round()
    assert not in_touch.collecting and in_touch.report((0.0, 0.0), EMPTY, greeting=True) is None
    known = in_touch.known
    in_touch.hear(at((0.0, 0.0), (1.0, 1.0), (2.0, 2.0)))
    assert in_touch.known is known and in_touch.positions(MISSION, ROW, EMPTY, ()) is None
    in_touch.begin()
    assert in_touch.collecting and not in_touch.known, "another mission"


@pytest.mark.parametrize("in_touch", [InTouch(0, MANY + 1), InTouch(0, N, enabled=False)], ids=["large", "keys"])
def test_large_teams_and_teams_with_keys_report_nothing_here(in_touch: InTouch) -> None:
    in_touch.begin_round()
    in_touch.hear(at((0.0, 0.0), (1.0, 1.0)))
    assert not in_touch.known and in_touch.report((0.0, 0.0), EMPTY, greeting=True) is None
    assert in_touch.positions(MISSION, ROW, EMPTY, ()) is None


def test_a_table_is_due_when_more_robots_live_than_it_places() -> None:
    in_touch = knowing((21.0, 0.0), (9.0, 0.0), (1.0, 0.0))
    found = in_touch.positions(MISSION, ROW, EMPTY, ())
    assert found is not None and found[1:] == ((0, 1, 2), ((21.0, 0.0), (9.0, 0.0), (1.0, 0.0)))
    table = optimal_assignment(ROW, found)
    assert owners(table) == [2, 1, 0, NO_OWNER] and placed(table) == 3
    assert in_touch.positions(MISSION, ROW, table, ()) is None, "the same three"
    two = in_touch.positions(MISSION, ROW, EMPTY, {1})
    assert two is not None and two[1] == (0, 2), "robot 1 is silent"
    assert in_touch.positions(MISSION, ROW, EMPTY, {1, 2}) is None, "nobody else is left"
    assert in_touch.positions(MISSION, ROW, (*EMPTY[:-1], (1, 0.0, BLOCKED)), ()) is None


def test_who_has_not_been_heard_for_some_rounds_has_flown_on_towards_its_place() -> None:
    in_touch = knowing((0.0, 0.0), (10.0, 60.0), (20.0, 1.0), rounds=3)
    in_touch.hear({0: (3, (0.0, 1.0), ())})
    table: BidTable = ((0, 0.0, 0), (0, 0.0, 1), (0, 0.0, 2), UNSAID)
    found = in_touch.positions(MISSION, ROW, table, ())
    far = 60.0 - 2 * MISSION.max_step
    assert found is not None and found[2] == ((0.0, 1.0), (10.0, far), (20.0, 0.0))
    assert in_touch.positions(MISSION, ROW, EMPTY, ()) != found, "without a place nobody knows where it flies"


def written(*places: Point) -> BidTable:
    """The table of a robot that knows these positions."""
    found = knowing(*places).positions(MISSION, ROW, EMPTY, ())
    assert found is not None
    return optimal_assignment(ROW, found)


def test_of_two_tables_the_one_that_places_more_wins_as_a_whole() -> None:
    fewer = [written((float(k), 0.0), (9.0, 0.0), (19.0, 0.0)) for k in range(9)]
    every = written((30.0, 0.0), (19.0, 0.0), (9.0, 0.0), (1.0, 0.0))
    assert owners(every) == [3, 2, 1, 0]
    for three in fewer:
        assert merge(three, every) == merge(every, three) == every, "whatever their digests are"
        assert merge(three, fewer[0]) == merge(fewer[0], three) and merge(three, fewer[0]) in (three, fewer[0])
        assert all(rank(entry) > rank((VERSION - 1, 0.0, 0)) for entry in three), "above bids and exchanges"


def now(robot: int, **changes: Any) -> AssignmentInput:
    given: dict[str, Any] = {
        "robot": robot,
        "position": (0.0, 0.0),
        "plan": ROW,
        "spacing": 10.0,
        "chosen": None,
        "adopted": True,
        "heard": (),
        "sensed": {},
        **changes,
    }
    return AssignmentInput(**given)


def test_a_robot_moves_to_its_new_place_though_its_old_one_has_come_free() -> None:
    rule = AuctionAssignment()
    alone = rule.take(now(0))
    assert alone.slot == 0
    found = knowing((0.0, 0.0), (-9.0, 0.0)).positions(MISSION, ROW, EMPTY, ())
    claim = rule.update(alone, now(0, positions=found))
    assert claim.slot == 1 and claim.table is not None and owners(claim.table) == [1, 0, NO_OWNER, NO_OWNER]
    late = AuctionAssignment(joint=False).update(alone, now(0, positions=found))
    assert late.slot == 0, "the rule without it bids on"
    freed: BidTable = ((1, 0.0, NO_OWNER), (1, 0.0, 0), UNSAID, UNSAID)
    held = Claim(slot=0, table=freed, bids=(0.0, -10.0, -20.0, -30.0))
    assert reclaimed(0, held, freed) is freed
    assert reclaimed(0, held, (freed[0], *EMPTY[1:]))[0] == (2, 0.0, 0), "nobody gave it another one"


def test_a_robot_that_no_joint_table_places_takes_what_it_leaves_free() -> None:
    table = written((0.0, 0.0), (9.0, 0.0))
    claim = AuctionAssignment().update(Claim(slot=None, table=table, bids=(0.0, -10.0, -20.0, -30.0)), now(3))
    assert claim.slot == 2 and claim.table is not None and owners(claim.table) == [0, 1, 3, NO_OWNER]
    assert math.isclose(claim.table[2][1], -20.0) and placed(claim.table) == 2


@pytest.mark.parametrize(("n", "jointly"), [(2, 2), (11, 11), (MANY, MANY), (MANY + 1, 0)])
def test_small_teams_are_placed_together(n: int, jointly: int) -> None:
    middle = 5.0 * (n - 1), 0.0
    mission = Mission(shape="line", n_robots=n, center=middle, arena=((-200, -100), (200, 100)), comm_range=400.0)
    row = Plan.of([[10.0 * k, 0.0] for k in range(n)])
    team = DrivenTeam(mission, "flock", [row] * n)
    team.begin([(10.0 * (n - k), 20.0) for k in range(n)])
    for _ in range(2):
        team.comm_round()
    assert team.plans == [row] * n and {placed(agent.claim.table) for agent in team.agents} == {jointly}


@pytest.mark.parametrize("n", [5, MANY + 1])
def test_who_places_nobody_together_states_no_positions(n: int) -> None:
    """The paper's rule has no table to write."""
    mission = Mission(shape="circle", n_robots=n, arena=((-200, -200), (300, 300)))
    row = Plan.of(mission.ideal or ())
    for preset, stated in (("paper", False), ("flock", True)):
        team = DrivenTeam(mission, preset, [row] * n)
        team.begin([(10.0 * k, 20.0) for k in range(n)])
        (effect,) = team.agents[0].handle(CommRoundBegan())
        assert isinstance(effect, Broadcast)
        assert (decode(effect.payload, n, 2).positions is not None) is stated
