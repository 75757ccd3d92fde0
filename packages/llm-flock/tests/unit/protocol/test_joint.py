"""Joint assignment: what is reported, when a table is written, and which one wins; in small teams and in large ones."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest
from driven_team import DrivenTeam
from hypothesis import given
from hypothesis import strategies as st
from tables import told as spelled
from whole_agent import whole_agent

from llm_flock.arrays import Point
from llm_flock.events import Broadcast, CommRoundBegan, Received, RoundBegan
from llm_flock.message import (
    BLOCKED,
    LAST_ROUND,
    NO_OWNER,
    UNSAID,
    BidTable,
    Message,
    MissionStamp,
    PositionReport,
    Provenance,
    decode,
    encode,
)
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.protocol._agreement.assignment import AssignmentInput, Claim
from llm_flock.protocol._agreement.auction import AuctionAssignment, gain, merge, rank, reclaim
from llm_flock.protocol._agreement.consensus import ProvenanceConsensus
from llm_flock.protocol._membership.joint import (
    MAX_WAITING,
    MOVED,
    PATIENCE,
    ROUNDS,
    SECOND,
    VERSION,
    JointAssignment,
    flown_straight,
    given_jointly,
    optimal_assignment,
    placed,
)
from llm_flock.protocol._membership.rendezvous import WITHIN
from llm_flock.protocol._membership.search import MANY

N = 4
MISSION = Mission(shape="line", n_robots=N, center=(15.0, 0.0), arena=((-100, -100), (100, 100)))
ROW = Plan.of([[10.0 * k, 0.0] for k in range(N)])
EMPTY: BidTable = (UNSAID,) * N


def at(*places: Point, round_number: int = 1) -> dict[int, PositionReport]:
    return {robot: (round_number, place, ()) for robot, place in enumerate(places)}


def knowing(*places: Point, rounds: int = 1) -> JointAssignment:
    """Robot 0, which has heard of the first robots in its first round."""
    in_touch = JointAssignment(0, N)
    in_touch.begin_round()
    in_touch.hear(at(*places))
    for _ in range(rounds - 1):
        in_touch.begin_round()
    return in_touch


def report(
    joint: JointAssignment, where: Point, table: BidTable = EMPTY, *, greeting: bool = True, plan: Plan | None = ROW
) -> dict[int, PositionReport] | None:
    return joint.report(MISSION, plan, table, where, greeting=greeting)


def owners(table: BidTable) -> list[int]:
    return [owner for _, _, owner in table]


def test_reports_are_passed_on_once_own_one_is_new_each_round() -> None:
    in_touch = JointAssignment(0, N)
    in_touch.begin_round()
    assert report(in_touch, (1.234, 5.0), EMPTY, greeting=True) == {0: (1, (1.23, 5.0), ())}
    in_touch.hear({2: (7, (9.0, 9.0), ())})
    assert report(in_touch, (1.234, 5.0), EMPTY, greeting=False) == {2: (7, (9.0, 9.0), ())}
    in_touch.hear({2: (6, (0.0, 0.0), ())})
    assert report(in_touch, (1.234, 5.0), EMPTY, greeting=False) is None, "older than what is known"
    in_touch.begin_round()
    everything = {0: (2, (2.0, 5.0), ()), 2: (7, (9.0, 9.0), ())}
    assert report(in_touch, (2.0, 5.0), EMPTY, greeting=True) == everything, "neighbours come and go between rounds"


def test_a_restarted_robot_counts_on_from_its_former_reports() -> None:
    in_touch = JointAssignment(0, N)
    in_touch.begin_round()
    in_touch.hear({0: (30, (9.0, 9.0), ())})
    assert (report(in_touch, (1.0, 1.0), EMPTY, greeting=True) or {})[0] == (31, (1.0, 1.0), ())
    in_touch.hear({0: (LAST_ROUND, (9.0, 9.0), ())})
    assert (report(in_touch, (1.0, 1.0), EMPTY, greeting=True) or {})[0] == (LAST_ROUND, (9.0, 9.0), ())


def test_reports_end_once_all_are_placed_or_none_arrives() -> None:
    everybody: BidTable = ((N * VERSION, 0.0, 0),) * N
    in_touch = knowing((0.0, 0.0), (5.0, 0.0))
    assert report(in_touch, (0.0, 0.0), everybody, greeting=True) is None
    assert report(in_touch, (0.0, 0.0), EMPTY, greeting=False) is None, "old news are not told later"
    for _ in range(PATIENCE):
        in_touch.begin_round()
        in_touch.hear(at((0.0, 0.0), (5.0, 1.0), round_number=9))
    assert in_touch.collecting
    in_touch.begin_round()
    assert not in_touch.collecting and report(in_touch, (0.0, 0.0), EMPTY, greeting=True) is None
    known = in_touch.known
    in_touch.hear(at((0.0, 0.0), (1.0, 1.0), (2.0, 2.0)))
    assert in_touch.known is known and in_touch.positions(MISSION, ROW, EMPTY, ()) is None
    in_touch.begin()
    assert in_touch.collecting and not in_touch.known, "another mission"


@pytest.mark.parametrize(
    "in_touch",
    [JointAssignment(0, MANY + 1, enabled=False), JointAssignment(0, N, enabled=False)],
    ids=["large", "small"],
)
def test_teams_with_keys_report_nothing(in_touch: JointAssignment) -> None:
    in_touch.begin_round()
    in_touch.hear(at((0.0, 0.0), (1.0, 1.0)))
    assert not in_touch.known and report(in_touch, (0.0, 0.0), EMPTY, greeting=True) is None
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
    assert in_touch.positions(MISSION, ROW, EMPTY, {1, 2}) is None, "no other is left"
    assert in_touch.positions(MISSION, ROW, (*EMPTY[:-1], (1, 0.0, BLOCKED)), ()) is None


def test_robot_unheard_for_rounds_has_flown_towards_its_place() -> None:
    in_touch = knowing((0.0, 0.0), (10.0, 60.0), (20.0, 1.0), rounds=3)
    in_touch.hear({0: (3, (0.0, 1.0), ())})
    table: BidTable = ((0, 0.0, 0), (0, 0.0, 1), (0, 0.0, 2), UNSAID)
    found = in_touch.positions(MISSION, ROW, table, ())
    far = 60.0 - 2 * MISSION.max_step
    assert found is not None and found[2] == ((0.0, 1.0), (10.0, far), (20.0, 0.0))
    assert in_touch.positions(MISSION, ROW, EMPTY, ()) != found, "without a place its destination is unknown"


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
        assert merge(three, every) == merge(every, three) == every, "with any digests"
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


def test_robot_moves_to_its_new_place_though_its_old_is_free() -> None:
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
    assert reclaim(0, held, freed) is freed
    assert reclaim(0, held, (freed[0], *EMPTY[1:]))[0] == (2, 0.0, 0), "it was given no other one"


def test_robot_unplaced_by_any_joint_table_takes_a_free_place() -> None:
    table = written((0.0, 0.0), (9.0, 0.0))
    claim = AuctionAssignment().update(Claim(slot=None, table=table, bids=(0.0, -10.0, -20.0, -30.0)), now(3))
    assert claim.slot == 2 and claim.table is not None and owners(claim.table) == [0, 1, 3, NO_OWNER]
    assert math.isclose(claim.table[2][1], -20.0) and placed(claim.table) == 2


@pytest.mark.parametrize(("n", "jointly"), [(2, 2), (11, 11), (MANY, MANY), (MANY + 1, MANY + 1)])
def test_teams_of_any_size_are_placed_together(n: int, jointly: int) -> None:
    middle = 5.0 * (n - 1), 0.0
    mission = Mission(shape="line", n_robots=n, center=middle, arena=((-200, -100), (200, 100)), comm_range=400.0)
    row = Plan.of([[10.0 * k, 0.0] for k in range(n)])
    team = DrivenTeam(mission, "flock", [row] * n)
    team.begin([(10.0 * (n - k), 20.0) for k in range(n)])
    for _ in range(2):
        team.comm_round()
    assert team.plans == [row] * n and {placed(agent.claim.table) for agent in team.agents} == {jointly}


@pytest.mark.parametrize("n", [5, MANY + 1])
def test_rule_without_joint_placement_states_no_positions(n: int) -> None:
    """The paper's rule has no table to write."""
    mission = Mission(shape="circle", n_robots=n, arena=((-200, -200), (300, 300)))
    row = Plan.of(mission.ideal or ())
    for preset, stated in (("paper", False), ("flock", True)):
        team = DrivenTeam(mission, preset, [row] * n)
        team.begin([(10.0 * k, 20.0) for k in range(n)])
        (effect,) = team.agents[0].handle(CommRoundBegan())
        assert isinstance(effect, Broadcast)
        assert (decode(effect.payload, n, 2).positions is not None) is stated


# ------------------------------------------------------------------ large teams

MANY_ROBOTS = MANY + 1
EVERYBODY = tuple(range(MANY_ROBOTS))
LONG_ROW = Plan.of([[10.0 * k, 0.0] for k in EVERYBODY])
NOBODY: BidTable = (UNSAID,) * MANY_ROBOTS
RADIUS = 50.0
CIRCLE = Plan.of(
    [[RADIUS * math.cos(k * math.tau / MANY_ROBOTS), RADIUS * math.sin(k * math.tau / MANY_ROBOTS)] for k in EVERYBODY]
)
LARGE = Mission(shape="circle", n_robots=MANY_ROBOTS, center=(0.0, 0.0), arena=((-900, -900), (900, 900)))


def starts(n: int = MANY_ROBOTS) -> list[Point]:
    return [(float(k), 1.0) for k in range(n)]


def reports_of(n: int = MANY_ROBOTS, stamp: int = 0, mark: Point = ()) -> dict[int, PositionReport]:
    return {robot: (stamp, where, mark) for robot, where in enumerate(starts(n))}


def on_circle(arc: float) -> Point:
    """The waiting point at this length along the circle [units]."""
    angle = arc / (WITHIN * RADIUS)
    return round(WITHIN * RADIUS * math.cos(angle), 2), round(WITHIN * RADIUS * math.sin(angle), 2)


def told(
    joint: JointAssignment, where: Point, *, plan: Plan | None = CIRCLE, table: BidTable = NOBODY, greeting: bool = True
) -> dict[int, PositionReport] | None:
    return joint.report(LARGE, plan, table, where, greeting=greeting)


def after(rounds: int = ROUNDS + 1, n: int = MANY_ROBOTS) -> JointAssignment:
    """What robot 0 of a large team knows after a number of rounds without news."""
    joint = JointAssignment(0, n)
    for _ in range(rounds):
        joint.begin_round()
    return joint


def test_a_large_team_passes_on_each_start_until_it_is_placed() -> None:
    team = [JointAssignment(robot, MANY_ROBOTS) for robot in EVERYBODY]
    for comm_round in range(MANY_ROBOTS - 1):
        sent = [told(robot, where, greeting=comm_round == 0) for robot, where in zip(team, starts(), strict=True)]
        for robot, joint in enumerate(team):
            for neighbor in (robot - 1, robot + 1):
                if 0 <= neighbor < MANY_ROBOTS:
                    joint.hear(sent[neighbor] or {})
        assert comm_round == MANY_ROBOTS - 2 or team[0].positions(LARGE, LONG_ROW, NOBODY, ()) is None
    found = {joint.positions(LARGE, LONG_ROW, NOBODY, ()) for joint in team}
    (positions,) = found
    assert positions is not None and positions[1:] == (EVERYBODY, tuple(starts()))
    assert told(team[0], (5.0, 5.0), greeting=False) == {MANY_ROBOTS - 1: (0, starts()[-1], ())}, "the newest report"
    assert told(team[0], (5.0, 5.0), greeting=False) is None, "nothing is sent twice"
    assert told(team[0], (5.0, 5.0)) == reports_of(), "neighbours come and go between rounds"
    table = optimal_assignment(LONG_ROW, positions)
    assert told(team[0], (5.0, 5.0), table=table) is None and team[0].positions(LARGE, LONG_ROW, table, ()) is None
    assert team[0].positions(LARGE, LONG_ROW, NOBODY, {3}) is None, "one is silent"


def test_starts_are_forgotten_when_they_are_out_of_date() -> None:
    joint = after(ROUNDS)
    joint.hear(reports_of())
    assert joint.positions(LARGE, LONG_ROW, NOBODY, ()) is not None
    joint.begin_round()
    joint.hear(reports_of())
    assert not joint.known and joint.positions(LARGE, LONG_ROW, NOBODY, ()) is None
    joint.begin()
    assert told(joint, (7.123, 1.0)) == {0: (0, (7.12, 1.0), ())}


def test_waiting_robot_reports_its_place_and_again_once_moved() -> None:
    joint = after()
    assert told(joint, on_circle(0.0), plan=LONG_ROW) is None, "there is no circle to wait on"
    assert told(joint, on_circle(0.0), plan=None) is None, "it has no plan"
    first = {0: (ROUNDS + 1, on_circle(0.0), on_circle(0.0))}
    assert ROUNDS + 1 > SECOND * MANY_ROBOTS and told(joint, (2.0, 0.0)) == first
    joint.begin_round()
    assert told(joint, on_circle(0.9 * MOVED * LARGE.spacing)) == first
    far = 1.5 * MOVED * LARGE.spacing
    again = {0: (ROUNDS + 2, on_circle(far), on_circle(0.0))}
    assert told(joint, on_circle(far)) == again, "the marked position stays"
    joint.hear({4: (30, (2.0, 2.0), ())})
    assert joint.others == [(2.0, 2.0)]


def test_waiting_positions_are_marked_in_a_certain_round() -> None:
    n = 100
    joint, row = after(n=n), Plan.of([[10.0 * k, 0.0] for k in range(n)])
    assert told(joint, on_circle(0.0)) == {0: (ROUNDS + 1, on_circle(0.0), ())}
    while joint._round <= SECOND * n:
        joint.begin_round()
    joint.hear(reports_of(n, 9))
    told(joint, on_circle(9.0))
    assert joint.known[0] == (16, on_circle(9.0), on_circle(9.0)), "whether or not it has moved"
    assert joint.positions(LARGE, row, EMPTY, ()) is None
    joint.hear({robot: (20, (0.0, 0.0), where) for robot, where in enumerate(starts(n)) if robot})
    found = joint.positions(LARGE, row, ((0, 0.0, 1), *EMPTY), ())
    assert found is not None and found[1:] == (tuple(range(n)), (on_circle(9.0), *starts(n)[1:]))


def test_a_robot_waits_until_no_unknown_robot_was_heard_for_long() -> None:
    joint = after()
    assert not JointAssignment(0, MANY_ROBOTS).waiting and not after(n=MANY).waiting
    for _ in range(2 * PATIENCE):
        joint.wait(there=False)
    for _ in range(PATIENCE):
        joint.wait(there=True)
    joint.hear({5: (ROUNDS + 1, (2.0, 2.0), ())})
    for _ in range(PATIENCE):
        joint.wait(there=True)
    joint.hear({5: (ROUNDS + 2, (3.0, 2.0), ())})
    assert joint.waiting, "a known robot's news do not count, but this is the last round"
    joint.wait(there=True)
    assert not joint.waiting
    joint.begin_round()
    joint.hear({6: (ROUNDS + 1, (2.0, 2.0), ())})
    assert not joint.known and told(joint, (0.0, 0.0)) is None


def test_the_largest_teams_do_not_wait() -> None:
    assert after(n=MAX_WAITING).waiting and not after(n=MAX_WAITING + 1).waiting
    assert told(after(ROUNDS, MAX_WAITING + 1), (0.0, 1.0)) == {0: (0, (0.0, 1.0), ())}


def test_surplus_places_stay_free_and_surplus_robots_get_no_slot() -> None:
    table = optimal_assignment(LONG_ROW, (2 * VERSION, (0, 1), ((1.0, 0.0), (12.0, 0.0))))
    assert owners(table)[:3] == [0, 1, NO_OWNER] and {version for version, _, _ in table} == {2 * VERSION}
    few = Plan.of([[0.0, 0.0], [10.0, 0.0]])
    table = optimal_assignment(few, (VERSION, (3, 5, 8), ((50.0, 0.0), (0.0, 0.0), (9.0, 0.0))))
    assert owners(table) == [5, 8]


@given(st.permutations(EVERYBODY))
def test_each_robot_above_a_row_gets_the_place_below_it(order: list[int]) -> None:
    table = optimal_assignment(LONG_ROW, (VERSION, EVERYBODY, tuple((10.0 * k, 3.0) for k in order)))
    assert owners(table) == [order.index(k) for k in EVERYBODY]
    assert {(version, bid) for version, bid, _ in table} == {(VERSION, 0.0)}


def test_an_entry_left_out_is_not_jointly_assigned() -> None:
    assert not given_jointly(None, 0) and not given_jointly((UNSAID,), 0)
    assert not given_jointly(((VERSION, 0.0, 3),), None) and given_jointly(((VERSION + 7, 0.0, 3),), 0)


def test_jointly_assigned_places_are_swapped_by_straight_lines() -> None:
    ring = Plan.of([[100 * math.cos(k * math.tau / 60), 100 * math.sin(k * math.tau / 60)] for k in range(60)])
    here = now(0, position=(99.0, 0.0), plan=ring)
    there = ring.points[1]
    straight = sum(
        sign * math.dist(where, ring.points[slot]) ** 2
        for sign, where, slot in ((1, (99.0, 0.0), 30), (1, there, 1), (-1, (99.0, 0.0), 1), (-1, there, 30))
    )
    assert gain(here, there, 30, 1, straight=True) == pytest.approx(straight)
    assert straight < 0 < gain(here, there, 30, 1)


@pytest.mark.parametrize(("version", "offered"), [(1, True), (VERSION, False), (VERSION + 1, False)])
def test_jointly_assigned_place_is_not_handed_on(version: int, *, offered: bool) -> None:
    """Across a ring, a robot flies straight to an assigned place; a place won by bids is handed on one by one."""
    ring = Plan.of([[100 * math.cos(k * math.tau / 60), 100 * math.sin(k * math.tau / 60)] for k in range(60)])
    table = tuple((version, -1.0, {30: 0, 1: 1}.get(slot, k)) for slot, k in zip(range(60), range(2, 62), strict=True))
    origin = Provenance(mission=0, mission_digest="0" * 16, epoch=0, degree=0, proposer=0, sequence=0)
    heard = Message(sender=1, sequence=0, degree=0, plan=ring, provenance=origin, slot=1, **spelled(table))
    here = now(0, position=(99.0, 0.0), plan=ring, heard=(heard,), sensed={1: ring.points[1]})
    claim = AuctionAssignment().update(Claim(slot=30, table=table, bids=(-1.0,) * 60), here)
    assert claim.slot == 30 and (claim.offer is not None) == offered
    assert flown_straight(table, 30) != offered
    assert not flown_straight(((VERSION, 0.0, 3),), 0), "in a small team they are handed on"


def test_a_robot_keeps_the_reports_of_its_own_mission_only() -> None:
    mission = Mission(shape="circle", n_robots=MANY_ROBOTS, spacing=6.0)
    agent = whole_agent(0, mission, ProvenanceConsensus(), AuctionAssignment(), shield_on=True)
    agent.handle(RoundBegan(round=1, position=(48.0, 50.0), degree=1, sensed={1: (50.0, 50.0)}, observed=()))
    heard = {1: (0, (50.0, 50.0), ()), 2: (0, (51.0, 40.0), ())}
    message = Message(sender=1, sequence=0, degree=1, stamp=MissionStamp(0, mission.digest), positions=heard)
    agent.handle(Received(encode(message)))
    assert agent._membership.known == heard
    elsewhere = msgspec.structs.replace(message, stamp=MissionStamp(0, "0" * 16), positions={3: (0, (9.0, 9.0), ())})
    agent.handle(Received(encode(elsewhere)))
    assert agent._membership.known == heard
