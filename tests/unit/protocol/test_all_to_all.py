"""All-to-all assignment of a large team: the two collections of positions, and the joint assignment."""

from __future__ import annotations

import math

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace
from tables import told
from whole_agent import whole_agent

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.protocol.agreement.assignment import AssignmentInput, Claim
from llm_flock.protocol.agreement.auction import AuctionAssignment, gain
from llm_flock.protocol.agreement.consensus import ProvenanceConsensus
from llm_flock.protocol.events import Received, RoundBegan
from llm_flock.protocol.membership.all_to_all import (
    LARGEST,
    MOVED,
    PATIENCE,
    ROUNDS,
    SECOND,
    VERSION,
    AllToAll,
    given_all_to_all,
    given_jointly,
    optimal_assignment,
)
from llm_flock.protocol.membership.in_touch import DIGESTS
from llm_flock.protocol.membership.rendezvous import WITHIN
from llm_flock.protocol.membership.search import MANY
from llm_flock.protocol.membership.team import TeamMembership
from llm_flock.protocol.messages.message import (
    LAST_ROUND,
    NO_OWNER,
    UNSAID,
    Message,
    MissionStamp,
    PositionReport,
    Provenance,
    TeamPositions,
    encode,
)
from llm_flock.protocol.plan import Plan

N = MANY + 1
EVERYBODY = tuple(range(N))
ROW = Plan.of([[10.0 * k, 0.0] for k in range(N)])
SPACING = 10.0
RADIUS = 50.0
CIRCLE = Plan.of([[RADIUS * math.cos(k * math.tau / N), RADIUS * math.sin(k * math.tau / N)] for k in range(N)])
MISSION = Mission(shape="circle", n_robots=N, spacing=SPACING, center=(0.0, 0.0), arena=((-900, -900), (900, 900)))
NO_CLAIM = Claim(slot=None)


def starts(n: int) -> list[Point]:
    return [(float(k), 1.0) for k in range(n)]


def reports_of(n: int, stamp: int = 0, mark: Point = ()) -> dict[int, PositionReport]:
    return {robot: (stamp, where, mark) for robot, where in enumerate(starts(n))}


def report(
    all_to_all: AllToAll, where: Point, *, greeting: bool = True, plan: Plan = ROW, settled: bool = False
) -> dict[int, PositionReport] | None:
    return all_to_all.report(MISSION, plan, where, settled=settled, greeting=greeting)


def on_circle(arc: float) -> Point:
    """The waiting point at this length along the circle [units]."""
    angle = arc / (WITHIN * RADIUS)
    return round(WITHIN * RADIUS * math.cos(angle), 2), round(WITHIN * RADIUS * math.sin(angle), 2)


def later(n: int = N, rounds: int = ROUNDS + 1) -> AllToAll:
    """The collection of robot 0 after a number of rounds."""
    all_to_all = AllToAll(0, n)
    for _ in range(rounds):
        all_to_all.begin_round()
    return all_to_all


def test_news_travel_one_robot_a_communication_round_and_everything_is_repeated_until_it_is_complete() -> None:
    alone = AllToAll(0, N)
    alone.hear({1: (0, (1.0, 1.0), ())})
    for greeting in (False, True, True):
        assert set(report(alone, (5.0, 5.0), greeting=greeting) or ()) == {0, 1}
    team = [AllToAll(robot, N) for robot in range(N)]
    for comm_round in range(N - 1):
        sent = [report(robot, where, greeting=comm_round == 0) for robot, where in zip(team, starts(N), strict=True)]
        for robot, all_to_all in enumerate(team):
            for neighbor in (robot - 1, robot + 1):
                if 0 <= neighbor < N:
                    all_to_all.hear(sent[neighbor] or {})
        assert comm_round == N - 2 or team[0].complete(ROW) is None
    assert [all_to_all.complete(ROW) for all_to_all in team] == [(VERSION, EVERYBODY, tuple(starts(N)))] * N
    assert report(team[0], (5.0, 5.0), greeting=False) == {N - 1: (0, starts(N)[-1], ())}, "the newest report"
    assert report(team[0], (5.0, 5.0), greeting=False) is None, "nothing is sent twice"
    assert report(team[0], (5.0, 5.0)) is None, "the table follows from it, and is sent instead"


def test_slots_are_assigned_once_for_each_plan() -> None:
    all_to_all = AllToAll(0, N)
    all_to_all.hear(reports_of(N))
    other = Plan.of([[10.0 * k, 5.0] for k in range(N)])
    assert all_to_all.complete(ROW) is not None and all_to_all.complete(ROW) is None
    assert all_to_all.complete(other) is not None


def test_outdated_positions_are_forgotten_and_a_new_mission_starts_a_new_collection() -> None:
    all_to_all = later(rounds=ROUNDS)
    report(all_to_all, (0.0, 1.0))
    all_to_all.hear(reports_of(N))
    all_to_all.begin_round()
    assert all_to_all.complete(ROW) is None and not all_to_all.known
    all_to_all.hear(reports_of(N))
    assert all_to_all.complete(ROW) is None and report(all_to_all, (0.0, 1.0)) is None
    all_to_all.begin()
    all_to_all.begin_round()
    assert report(all_to_all, (7.123, 1.0)) == {0: (0, (7.12, 1.0), ())}


@pytest.mark.parametrize("all_to_all", [AllToAll(0, MANY), AllToAll(0, N, enabled=False)], ids=["small", "keys"])
def test_small_teams_and_teams_with_keys_collect_nothing(all_to_all: AllToAll) -> None:
    for _ in range(ROUNDS + 1):
        all_to_all.begin_round()
        assert not (all_to_all.large or all_to_all.collecting or all_to_all.waiting)
        assert report(all_to_all, (0.0, 0.0)) is None
        all_to_all.hear(reports_of(N))
        assert all_to_all.complete(ROW) is None


def test_in_the_second_collection_a_robot_reports_where_it_waits_and_again_when_it_has_moved() -> None:
    all_to_all = later()
    assert report(all_to_all, on_circle(0.0)) is None, "there is no circle to wait on"
    assert report(all_to_all, on_circle(0.0), plan=CIRCLE, settled=True) is None, "it has a slot already"
    assert all_to_all.report(MISSION, None, on_circle(0.0), settled=False, greeting=True) is None, "it has no plan"
    first = {0: (ROUNDS + 1, on_circle(0.0), on_circle(0.0))}
    assert ROUNDS + 1 > SECOND * N
    assert report(all_to_all, on_circle(0.0), plan=CIRCLE) == first
    all_to_all.begin_round()
    assert report(all_to_all, on_circle(0.9 * MOVED * SPACING), plan=CIRCLE) == first
    far = 1.5 * MOVED * SPACING
    again = {0: (ROUNDS + 2, on_circle(far), on_circle(0.0))}
    assert report(all_to_all, on_circle(far), plan=CIRCLE) == again, "the marked position stays"


def test_the_second_collection_marks_waiting_positions_in_a_certain_round() -> None:
    n = 100
    all_to_all = later(n)
    assert report(all_to_all, on_circle(0.0), plan=CIRCLE) == {0: (ROUNDS + 1, on_circle(0.0), ())}
    while all_to_all._round <= SECOND * n:
        assert all_to_all.complete(ROW) is None
        all_to_all.begin_round()
    all_to_all.hear(reports_of(n, 3))
    report(all_to_all, on_circle(9.0), plan=CIRCLE)
    assert all_to_all.known[0] == (16, on_circle(9.0), on_circle(9.0)) and all_to_all.complete(ROW) is None
    all_to_all.hear({robot: (20, where, where) for robot, where in enumerate(starts(n)) if robot})
    assert all_to_all.complete(ROW) == (2 * VERSION, tuple(range(n)), (on_circle(9.0), *starts(n)[1:]))


def test_the_newest_report_counts_and_a_restarted_robot_continues_its_own_numbers() -> None:
    all_to_all, here = later(), on_circle(0.0)
    all_to_all.hear({0: (30, (1.0, 1.0), ()), 1: (30, (2.0, 2.0), ())})
    all_to_all.hear({1: (29, (5.0, 5.0), ())})
    assert all_to_all.others == [(2.0, 2.0)]
    assert report(all_to_all, here, plan=CIRCLE) == {0: (31, here, here), 1: (30, (2.0, 2.0), ())}
    all_to_all.hear({0: (LAST_ROUND, (1.0, 1.0), ())})
    kept = {0: (LAST_ROUND, (1.0, 1.0), ()), 1: (30, (2.0, 2.0), ())}
    assert report(all_to_all, here, plan=CIRCLE) == kept


def test_a_robot_waits_until_no_unknown_robot_was_heard_for_long() -> None:
    all_to_all = later()
    assert not AllToAll(0, N).waiting
    for _ in range(2 * PATIENCE):
        all_to_all.wait(there=False)
    for _ in range(PATIENCE):
        all_to_all.wait(there=True)
    all_to_all.hear({5: (ROUNDS + 1, (2.0, 2.0), ())})
    for _ in range(PATIENCE):
        all_to_all.wait(there=True)
    all_to_all.hear({5: (ROUNDS + 2, (3.0, 2.0), ())})
    assert all_to_all.waiting, "a known robot's news do not count, but this is the last round"
    all_to_all.wait(there=True)
    assert not all_to_all.waiting
    all_to_all.begin_round()
    all_to_all.hear({6: (ROUNDS + 1, (2.0, 2.0), ())})
    assert not all_to_all.waiting and not all_to_all.known and report(all_to_all, (0.0, 0.0), plan=CIRCLE) is None


def test_the_largest_teams_have_the_first_collection_only() -> None:
    assert later(LARGEST).waiting and not later(LARGEST + 1).waiting
    assert report(later(LARGEST + 1, ROUNDS), (0.0, 1.0)) == {0: (0, (0.0, 1.0), ())}


@given(st.permutations(range(N)))
def test_each_of_robots_above_the_places_of_a_row_gets_the_place_below_it(order: list[int]) -> None:
    places = tuple((10.0 * k, 3.0) for k in order)
    table = optimal_assignment(ROW, (VERSION, EVERYBODY, places))
    assert [owner for _, _, owner in table] == [order.index(k) for k in range(N)]
    assert {version for version, _, _ in table} == {VERSION} and {bid for _, bid, _ in table} == {0.0}


def test_surplus_places_stay_free_and_surplus_robots_get_no_slot() -> None:
    table = optimal_assignment(ROW, (2 * VERSION, (0, 1), ((1.0, 0.0), (12.0, 0.0))))
    assert [owner for _, _, owner in table[:3]] == [0, 1, NO_OWNER]
    assert {version for version, _, _ in table} == {2 * VERSION}
    few = Plan.of([[0.0, 0.0], [10.0, 0.0]])
    table = optimal_assignment(few, (VERSION, (3, 5, 8), ((50.0, 0.0), (0.0, 0.0), (9.0, 0.0))))
    assert [owner for _, _, owner in table] == [5, 8]


def moment(positions: TeamPositions | None) -> AssignmentInput:
    return AssignmentInput(
        robot=1,
        position=(0.0, 0.0),
        plan=ROW,
        spacing=10.0,
        chosen=None,
        adopted=True,
        heard=(),
        sensed={},
        positions=positions,
    )


def test_a_joint_assignment_replaces_bids_and_exchanges_continue_from_it() -> None:
    rule = AuctionAssignment()
    claim = rule.take(moment(None))
    assert claim.slot == 0 and not given_all_to_all(claim.table, 0)
    # Robot 0 is nearer to the first place: the joint assignment gives it to robot 0 although robot 1 had bid for it.
    positions = (VERSION, EVERYBODY, ((-5.0, 0.0), (0.0, 0.0), *((10.0 * k, 0.0) for k in range(2, N))))
    claim = rule.update(claim, moment(positions))
    assert claim.slot == 1 and claim.table is not None and given_all_to_all(claim.table, 1)
    assert sorted(owner for _, _, owner in claim.table) == list(range(N))
    assert rule.update(claim, moment(None)) == claim
    assert not given_all_to_all(None, 0)


def test_jointly_assigned_places_are_exchanged_by_straight_distances() -> None:
    ring = Plan.of([[100 * math.cos(k * math.tau / 60), 100 * math.sin(k * math.tau / 60)] for k in range(60)])
    now = AssignmentInput(
        robot=0,
        position=(99.0, 0.0),
        plan=ring,
        spacing=10.0,
        chosen=None,
        adopted=True,
        heard=(),
        sensed={},
    )
    there = ring.points[1]
    straight = sum(
        sign * math.dist(where, ring.points[slot]) ** 2
        for sign, where, slot in ((1, (99.0, 0.0), 30), (1, there, 1), (-1, (99.0, 0.0), 1), (-1, there, 30))
    )
    assert gain(now, there, 30, 1, straight=True) == pytest.approx(straight)
    assert straight < 0 < gain(now, there, 30, 1)


@pytest.mark.parametrize(("version", "offered"), [(1, True), (VERSION, False), (VERSION + 1, False)])
def test_a_jointly_assigned_place_is_not_handed_on_along_the_formation(version: int, *, offered: bool) -> None:
    """Across a ring, a robot flies straight to an assigned place; a place won by bids is handed on one by one."""
    ring = Plan.of([[100 * math.cos(k * math.tau / 60), 100 * math.sin(k * math.tau / 60)] for k in range(60)])
    table = tuple((version, -1.0, {30: 0, 1: 1}.get(slot, k)) for slot, k in zip(range(60), range(2, 62), strict=True))
    origin = Provenance(mission=0, mission_digest="0" * 16, epoch=0, degree=0, proposer=0, sequence=0)
    heard = Message(sender=1, sequence=0, degree=0, plan=ring, provenance=origin, slot=1, **told(table))
    now = replace(moment(None), robot=0, position=(99.0, 0.0), plan=ring, heard=(heard,), sensed={1: ring.points[1]})
    claim = AuctionAssignment().update(Claim(slot=30, table=table, bids=(-1.0,) * 60), now)
    assert claim.slot == 30 and (claim.offer is not None) == offered


def test_an_entry_left_out_is_not_jointly_assigned() -> None:
    assert not given_all_to_all((UNSAID,), 0) and not given_all_to_all(((VERSION, 0.0, 3),), None)


def test_places_given_to_robots_in_touch_are_exchanged_along_the_formation() -> None:
    assert given_all_to_all(((2 * VERSION + 7, 0.0, 3),), 0)
    in_touch = ((2 * DIGESTS * VERSION, 0.0, 3),)
    assert given_jointly(in_touch, 0) and not given_all_to_all(in_touch, 0)


def test_a_robot_keeps_the_reports_of_its_own_mission_only() -> None:
    mission = Mission(shape="circle", n_robots=N, spacing=6.0)
    agent = whole_agent(0, mission, ProvenanceConsensus(), AuctionAssignment(), shield_on=True)
    agent.handle(RoundBegan(round=1, position=(48.0, 50.0), degree=1, sensed={1: (50.0, 50.0)}, observed=()))
    heard = {1: (0, (50.0, 50.0), ()), 2: (0, (51.0, 40.0), ())}
    message = Message(sender=1, sequence=0, degree=1, stamp=MissionStamp(0, mission.digest), positions=heard)
    agent.handle(Received(encode(message)))
    membership = agent._membership
    assert isinstance(membership, TeamMembership)
    assert {robot: membership.all_to_all.known[robot] for robot in heard} == heard
    elsewhere = msgspec.structs.replace(message, stamp=MissionStamp(0, "0" * 16), positions={3: (0, (9.0, 9.0), ())})
    agent.handle(Received(encode(elsewhere)))
    assert 3 not in membership.all_to_all.known
