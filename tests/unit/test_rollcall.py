"""The roll call of a large team: who says what, for how long, and what comes of it."""

from __future__ import annotations

import math

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from llm_flock.arrays import Point
from llm_flock.mission import Mission
from llm_flock.protocol.agent import Agent
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
    assigned,
    given_all_to_all,
)
from llm_flock.protocol.membership.search import MANY
from llm_flock.protocol.messages.codec import encode
from llm_flock.protocol.messages.message import (
    LAST_ROUND,
    NO_OWNER,
    UNSAID,
    Message,
    MissionStamp,
    PositionReport,
    Provenance,
    TeamPositions,
)
from llm_flock.protocol.plan import Plan

N = MANY + 1
ROW = Plan.of([[10.0 * k, 0.0] for k in range(N)])
SPACING = 10.0


def starts(n: int) -> list[Point]:
    return [(float(k), 1.0) for k in range(n)]


def sightings(n: int, stamp: int = 0, mark: Point = ()) -> dict[int, PositionReport]:
    return {robot: (stamp, where, mark) for robot, where in enumerate(starts(n))}


def say(
    call: AllToAll, where: Point, *, greeting: bool = True, waits_at: Point | None = None, settled: bool = False
) -> dict[int, PositionReport] | None:
    return call.say(where, waits_at=waits_at, greeting=greeting, settled=settled, spacing=SPACING)


def later(n: int = N, rounds: int = ROUNDS + 1) -> AllToAll:
    call = AllToAll(0, n)
    for _ in range(rounds):
        call.begin_round()
    return call


def test_news_travel_a_robot_a_tick_and_everything_is_said_once_a_round() -> None:
    calls = [AllToAll(robot, N) for robot in range(N)]
    for comm_round in range(N - 1):
        said = [say(call, where, greeting=comm_round == 0) for call, where in zip(calls, starts(N), strict=True)]
        for robot, call in enumerate(calls):
            for neighbor in (robot - 1, robot + 1):
                if 0 <= neighbor < N:
                    call.hear(said[neighbor] or {})
        assert comm_round == N - 2 or calls[0].complete(ROW) is None
    assert [call.complete(ROW) for call in calls] == [(VERSION, tuple(starts(N)))] * N
    assert say(calls[0], (5.0, 5.0), greeting=False) == {N - 1: (0, starts(N)[-1], ())}, "the last that it heard of"
    assert say(calls[0], (5.0, 5.0), greeting=False) is None, "and nothing is said twice"
    assert say(calls[0], (5.0, 5.0)) == sightings(N), "but to greet"


def test_the_places_are_given_out_once_for_each_plan() -> None:
    call = AllToAll(0, N)
    call.hear(sightings(N))
    other = Plan.of([[10.0 * k, 5.0] for k in range(N)])
    assert call.complete(ROW) is not None and call.complete(ROW) is None
    assert call.complete(other) is not None


def test_positions_that_are_no_longer_true_are_forgotten_and_a_new_mission_calls_anew() -> None:
    call = later(rounds=ROUNDS)
    say(call, (0.0, 1.0))
    call.hear(sightings(N))
    call.begin_round()
    assert call.complete(ROW) is None and not call.known
    call.hear(sightings(N))
    assert call.complete(ROW) is None and say(call, (0.0, 1.0)) is None
    call.begin()
    call.begin_round()
    assert say(call, (7.123, 1.0)) == {0: (0, (7.12, 1.0), ())}


def test_small_teams_call_no_roll() -> None:
    call = AllToAll(0, MANY)
    call.begin_round()
    assert say(call, (0.0, 0.0)) is None
    call.hear(sightings(MANY))
    assert call.complete(ROW) is None
    assert not later(MANY).waiting
    assert AllToAll(0, 0).complete(ROW) is None, "nor does one whose claims are signed"


def test_later_on_those_who_wait_say_where_and_say_it_anew_when_they_have_moved() -> None:
    call = later()
    assert say(call, (0.0, 0.0)) is None, "it does not wait"
    assert say(call, (0.0, 0.0), waits_at=(3.0, 0.0), settled=True) is None, "it has a place"
    first = {0: (ROUNDS + 1, (3.0, 0.0), (3.0, 0.0))}
    assert ROUNDS + 1 > SECOND * N
    assert say(call, (0.0, 0.0), waits_at=(3.0, 0.0)) == first
    call.begin_round()
    assert say(call, (0.0, 0.0), waits_at=(3.0 + MOVED * SPACING, 0.0)) == first
    moved = say(call, (0.0, 0.0), waits_at=(3.5 + MOVED * SPACING, 0.0))
    assert moved == {0: (ROUNDS + 2, (4.5, 0.0), (3.0, 0.0))}, "what was taken down stays"


def test_the_second_call_takes_down_where_everybody_waits_in_a_certain_round() -> None:
    n = 100
    call = later(n)
    assert say(call, (0.0, 0.0), waits_at=(3.0, 0.0)) == {0: (ROUNDS + 1, (3.0, 0.0), ())}
    while call._round <= SECOND * n:
        assert call.complete(ROW) is None
        call.begin_round()
    call.hear(sightings(n, 3))
    say(call, (0.0, 0.0), waits_at=(9.0, 0.0))
    assert call.known[0] == (16, (9.0, 0.0), (9.0, 0.0)) and call.complete(ROW) is None
    call.hear({robot: (20, where, where) for robot, where in enumerate(starts(n)) if robot})
    assert call.complete(ROW) == (2 * VERSION, ((9.0, 0.0), *starts(n)[1:]))


def test_the_newest_is_believed_and_who_was_restarted_counts_on_from_its_former_life() -> None:
    call = later()
    call.hear({0: (30, (1.0, 1.0), ()), 1: (30, (2.0, 2.0), ())})
    call.hear({1: (29, (5.0, 5.0), ())})
    assert call.others == [(2.0, 2.0)]
    said = say(call, (0.0, 0.0), waits_at=(3.0, 0.0))
    assert said == {0: (31, (3.0, 0.0), (3.0, 0.0)), 1: (30, (2.0, 2.0), ())}
    call.hear({0: (LAST_ROUND, (1.0, 1.0), ())})
    assert say(call, (0.0, 0.0), waits_at=(3.0, 0.0)) == {0: (LAST_ROUND, (1.0, 1.0), ()), 1: (30, (2.0, 2.0), ())}


def test_one_waits_until_nobody_new_is_heard_of_for_long() -> None:
    call = later()
    assert not AllToAll(0, N).waiting
    for _ in range(2 * PATIENCE):
        call.wait(there=False)
    for _ in range(PATIENCE):
        call.wait(there=True)
    call.hear({5: (ROUNDS + 1, (2.0, 2.0), ())})
    for _ in range(PATIENCE):
        call.wait(there=True)
    call.hear({5: (ROUNDS + 2, (3.0, 2.0), ())})
    assert call.waiting, "news of who was known do not count, but it is still the last round"
    call.wait(there=True)
    assert not call.waiting
    call.begin_round()
    call.hear({6: (ROUNDS + 1, (2.0, 2.0), ())})
    assert not call.waiting and not call.known and say(call, (0.0, 0.0), waits_at=(3.0, 0.0)) is None


def test_the_largest_teams_call_the_roll_at_the_beginning_only() -> None:
    assert later(LARGEST).waiting and not later(LARGEST + 1).waiting
    assert say(later(LARGEST + 1, ROUNDS), (0.0, 1.0)) == {0: (0, (0.0, 1.0), ())}


@given(st.permutations(range(N)))
def test_all_who_know_the_same_write_the_same_and_nobody_flies_across(order: list[int]) -> None:
    """Robots above the places of a row, in any order: each gets the place below it."""
    places = tuple((10.0 * k, 3.0) for k in order)
    table = assigned(ROW, (VERSION, places))
    assert [owner for _, _, owner in table] == [order.index(k) for k in range(N)]
    assert {version for version, _, _ in table} == {VERSION} and {bid for _, bid, _ in table} == {-3.0}


def test_places_that_are_left_over_are_free_and_robots_may_be_left_over_too() -> None:
    table = assigned(ROW, (2 * VERSION, ((1.0, 0.0), (12.0, 0.0))))
    assert [owner for _, _, owner in table[:3]] == [0, 1, NO_OWNER]
    assert {version for version, _, _ in table} == {2 * VERSION}
    few = Plan.of([[0.0, 0.0], [10.0, 0.0]])
    assert [owner for _, _, owner in assigned(few, (VERSION, ((50.0, 0.0), (0.0, 0.0), (9.0, 0.0))))] == [1, 2]


def moment(roll: TeamPositions | None) -> AssignmentInput:
    return AssignmentInput(
        robot=1,
        position=(0.0, 0.0),
        plan=ROW,
        spacing=10.0,
        chosen=None,
        adopted=True,
        heard=(),
        sensed={},
        positions=roll,
    )


def test_the_auction_gives_way_to_the_roll_and_exchanges_go_on_from_there() -> None:
    rule = AuctionAssignment()
    claim = rule.take(moment(None))
    assert claim.slot == 0 and not given_all_to_all(claim.table, 0)
    # Robot 0 is nearer to the first place: by the roll it is not for robot 1, which had bid for it.
    roll = (VERSION, ((-5.0, 0.0), (0.0, 0.0), *((10.0 * k, 0.0) for k in range(2, N))))
    claim = rule.update(claim, moment(roll))
    assert claim.slot == 1 and claim.table is not None and given_all_to_all(claim.table, 1)
    assert sorted(owner for _, _, owner in claim.table) == list(range(N))
    assert rule.update(claim, moment(None)) == claim
    assert not given_all_to_all(None, 0)


def test_places_of_a_roll_are_exchanged_by_straight_ways() -> None:
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
def test_a_place_of_the_roll_is_not_handed_on_along_the_formation(version: int, *, offered: bool) -> None:
    """Across a ring one flies straight to a place of the roll; one that was won by bids moves up, place by place."""
    ring = Plan.of([[100 * math.cos(k * math.tau / 60), 100 * math.sin(k * math.tau / 60)] for k in range(60)])
    table = tuple((version, -1.0, {30: 0, 1: 1}.get(slot, k)) for slot, k in zip(range(60), range(2, 62), strict=True))
    origin = Provenance(mission=0, mission_digest="0" * 16, epoch=0, neighbors=0, proposer=0, sequence=0)
    heard = Message(sender=1, sequence=0, neighbors=0, plan=ring, provenance=origin, slot=1, table=table)
    now = replace(moment(None), robot=0, position=(99.0, 0.0), plan=ring, heard=(heard,), sensed={1: ring.points[1]})
    claim = AuctionAssignment().update(Claim(slot=30, table=table, bids=(-1.0,) * 60), now)
    assert claim.slot == 30 and (claim.offer is not None) == offered


def test_an_entry_left_out_is_below_every_roll() -> None:
    assert not given_all_to_all((UNSAID,), 0) and not given_all_to_all(((VERSION, 0.0, 3),), None)


def test_a_robot_keeps_what_it_hears_of_the_roll() -> None:
    mission = Mission(shape="circle", n_robots=N, spacing=6.0)
    agent = Agent(0, mission, ProvenanceConsensus(), AuctionAssignment(), shield_on=True)
    agent.handle(RoundBegan(round=1, position=(48.0, 50.0), neighbors=1, sensed={1: (50.0, 50.0)}, observed=()))
    heard = {1: (0, (50.0, 50.0), ()), 2: (0, (51.0, 40.0), ())}
    message = Message(sender=1, sequence=0, neighbors=1, mission=MissionStamp(0, mission.digest), positions=heard)
    agent.handle(Received(encode(message)))
    assert {robot: agent._agreement.all_to_all.known[robot] for robot in heard} == heard
    elsewhere = msgspec.structs.replace(message, mission=MissionStamp(0, "0" * 16), positions={3: (0, (9.0, 9.0), ())})
    agent.handle(Received(encode(elsewhere)))
    assert 3 not in agent._agreement.all_to_all.known
