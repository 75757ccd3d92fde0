"""The search that ends frozen partitions: which robot goes, where, and when it stops."""

from functools import partial
from itertools import groupby
from types import SimpleNamespace
from typing import Any, cast

import pytest

from llm_flock.arrays import Point
from llm_flock.message import NO_OWNER, BidTable
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.protocol._agreement.assignment import Claim
from llm_flock.protocol._membership.connectivity import APART, REMEMBERED, ConnectivityRecovery
from llm_flock.protocol._membership.search import (
    LOOKS,
    LOOKS_FOR_SILENT,
    MANY,
    PATIENCE,
    PATIENCE_PER_PLACE,
    Search,
    Seeking,
    advance,
    longest_search,
)
from llm_flock.protocol._parts import Situation

PLAN = Plan.of([[0, 0], [10, 0], [20, 0], [30, 0]])
CENTER = (15.0, 0.0)


MISSION = Mission(shape="line", n_robots=4, center=CENTER, arena=((-100.0, -50.0), (100.0, 50.0)))


def situation(owners: BidTable, here: Point, *bodies: Point, slot: int = 0) -> Situation:
    now = Situation(MISSION)
    now.plan, now.claim, now.position = PLAN, Claim(slot=slot, table=owners), here
    now.sensed = dict(enumerate(bodies, 1))
    return now


living = partial(SimpleNamespace, without_plan=set[int](), time_out=10)


def table(*owners: int) -> BidTable:
    return tuple((0, -1.0 if owner != NO_OWNER else 0.0, owner) for owner in owners)


def step(search: Search, x: float, slot: int, owners: BidTable, *, strangers: int = 1, silent: int = 0) -> Search:
    return advance(search, situation(owners, (x, 0.0), slot=slot), PLAN, strangers=strangers, silent=silent)


def rounds_until_off(slot: int, owners: BidTable) -> int:
    search, count = Search(), 0
    while search.target is None:
        search, count = step(search, 10.0 * slot, slot, owners), count + 1
        assert count < 100
    return count


def test_a_full_team_stays() -> None:
    search = Search()
    for _ in range(50):
        search = step(search, 0.0, 0, table(0, 1, 2, 3))
    assert search.target is None


def test_a_tour_leads_by_places_of_earlier_missions() -> None:
    """Those within half the radio range of the present places are passed anyway; a formation that moves has none."""
    now = situation(table(0, 1, 2, NO_OWNER), (20.0, 0.0), slot=2)
    now.earlier = ((33.0, 5.0), (60.0, 0.0), (60.0, 20.0))
    search = Search(waited=PATIENCE, known=(PLAN.digest, (3,)))
    assert advance(search, now, PLAN, strangers=0, silent=1).way == ((30.0, 0.0), (60.0, 0.0), (60.0, 20.0))
    now.mission = MISSION.change(velocity=(1.0, 0.0))
    assert advance(search, now, PLAN, strangers=0, silent=1).way == ((30.0, 0.0),)


def test_a_robot_alone_looks_for_others_ever_more_rarely() -> None:
    now, seeking = situation(table(0, 1, 2, 3), (0.0, 0.0)), Seeking(0)
    out: list[bool] = []
    for _ in range(140):
        seeking.wait_for_neighbours(now, met=False)
        out.append(seeking.sets_out)
        if seeking.sets_out and (point := seeking.target(MISSION, now.position)) is not None:
            now.position = point
        if not seeking.sets_out:
            now.position = (0.0, 0.0)
    waits = [len(list(group)) for away, group in groupby(out) if not away]
    assert waits[:3] == [8, 17, 33], "a round longer after a tour, in which it flies back"
    seeking.wait_for_neighbours(now, met=True)
    assert not seeking.sets_out


@pytest.mark.parametrize("case", ["no plan", "no place", "under way", "places out of range"])
def test_a_robot_that_should_meet_nobody_waits(case: str) -> None:
    now, seeking = situation(table(0, 1, 2, 3), (0.0, 0.0)), Seeking(0)
    match case:
        case "no plan":
            now.plan = None
        case "no place":
            now.claim = Claim(slot=None)
        case "under way":
            now.position = (0.0, 1.0)
        case _:
            now.mission = MISSION.change(comm_range=9, sense_range=15)
    for _ in range(40):
        seeking.wait_for_neighbours(now, met=False)
    assert not seeking.sets_out


def test_longest_search_outlasts_every_search() -> None:
    """Survivors of ten with a search that ends in vain: the bound is not below what they took."""
    for missing, took in ((9, 79), (8, 98), (7, 63)):
        assert took <= longest_search(Mission(shape="circle", n_robots=10), missing) + 10


def test_the_robot_next_to_a_vacant_place_goes_first() -> None:
    owners = table(0, 1, 2, NO_OWNER)
    assert rounds_until_off(2, owners) == PATIENCE + 1
    assert rounds_until_off(1, owners) == PATIENCE + 1 + int(0.5 * PATIENCE_PER_PLACE)
    assert rounds_until_off(0, owners) > rounds_until_off(1, owners)


def test_a_robot_on_its_way_does_not_search() -> None:
    search = Search()
    for _ in range(50):
        search = step(search, 5.0, 2, table(0, 1, 2, NO_OWNER))
    assert search.target is None


def test_the_tour_visits_the_nearest_vacant_place_first_and_ends() -> None:
    owners = table(NO_OWNER, 1, NO_OWNER, NO_OWNER)
    search = Search()
    while search.target is None:
        search = step(search, 10.0, 1, owners)
    assert search.way == ((0.0, 0.0), (20.0, 0.0), (30.0, 0.0))
    looked = list[tuple[int, ...]]()
    for x in (0.0, 18.0, 30.0):
        assert search.target is not None
        search = step(search, x, 1, owners)
        looked.append(search.looked)
    assert search.target is None and looked == [(0,), (2,), (3,)]


def test_new_knowledge_ends_the_tour() -> None:
    search = Search()
    while search.target is None:
        search = step(search, 20.0, 2, table(0, 1, 2, NO_OWNER))
    assert step(search, 25.0, 2, table(0, 1, 2, 3)).target is None


def off_among_many(slot: int, owners: BidTable) -> Search:
    search = Search()
    while search.target is None:
        search = step(search, 10.0 * slot, slot, owners, strangers=MANY + 1)
    return search


def test_tour_with_many_missing_lasts_until_its_goal_is_taken() -> None:
    search = off_among_many(1, table(NO_OWNER, 1, NO_OWNER, NO_OWNER))
    assert search.target == (0.0, 0.0)
    on = step(search, 7.0, 1, table(NO_OWNER, 1, NO_OWNER, 3), strangers=MANY + 1)
    assert on.target == search.target
    assert step(search, 7.0, 1, table(0, 1, NO_OWNER, NO_OWNER), strangers=MANY + 1).target is None
    assert step(search, 7.0, 1, table(NO_OWNER, 1, NO_OWNER, 3), strangers=MANY).target is None


def test_distant_news_do_not_restart_the_wait_of_many_missing() -> None:
    far, near = table(0, 1, NO_OWNER, 3), table(0, NO_OWNER, NO_OWNER, 3)
    waited = step(Search(), 0.0, 0, table(0, 1, NO_OWNER, NO_OWNER), strangers=MANY + 1)
    assert waited.waited == 1
    assert step(waited, 0.0, 0, far, strangers=MANY + 1).waited == 2
    assert step(waited, 0.0, 0, near, strangers=MANY + 1).waited == 1


def looking_on(slot: int, owners: BidTable, *, strangers: int, silent: int) -> tuple[Search, list[int], list[object]]:
    """Rounds of waiting before each tour, and the tours, of a robot that meets no other and counts its looks."""
    search, waits, ways, entries = Search(), [0], list[object](), list(owners)
    for _ in range(300):
        here = 10.0 * slot if search.target is None else search.target[0]
        search = step(search, here, slot, tuple(entries), strangers=strangers, silent=silent)
        for a in search.looked:
            entries[a] = (entries[a][0], entries[a][1] + 1, NO_OWNER)
        if search.target is None:
            waits[-1] += 1
        elif waits[-1]:
            ways.append(search.way)
            waits.append(0)
    return search, waits[:-1], ways


def test_vain_searches_wait_longer_and_end_at_the_centre() -> None:
    search, waits, ways = looking_on(2, table(0, 1, 2, NO_OWNER), strangers=1, silent=0)
    assert search.given_up and search.gaps == (3,) and len(ways) == LOOKS
    assert waits == sorted(waits) and waits[0] < waits[-1]
    assert ways[0] == ((30.0, 0.0),) and ways[-1] == ((30.0, 0.0), CENTER)


def test_looks_of_others_count() -> None:
    owners = table(0, 1, 2, NO_OWNER)
    seen = (*owners[:3], (0, float(LOOKS), NO_OWNER))
    search = step(step(Search(), 20.0, 2, owners), 20.0, 2, seen)
    assert search.given_up and search.target is None


def test_robots_in_touch_with_all_do_not_search() -> None:
    search = Search()
    for _ in range(50):
        search = step(search, 20.0, 2, table(0, 1, 2, NO_OWNER), strangers=0)
    assert search.target is None and not search.given_up


def test_the_tour_ends_when_the_last_stranger_is_heard_of() -> None:
    owners, search = table(0, 1, 2, NO_OWNER), Search()
    while search.target is None:
        search = step(search, 20.0, 2, owners)
    assert step(search, 25.0, 2, owners, strangers=0).target is None


def test_for_the_silent_a_short_look_must_do() -> None:
    search, _, ways = looking_on(2, table(0, 1, 2, NO_OWNER), strangers=0, silent=1)
    assert search.given_up and len(ways) == LOOKS_FOR_SILENT


def test_robot_without_plan_is_sought_at_centre_in_first_tour() -> None:
    """It has nowhere else to go; one that was silent with a plan is looked for in vacant slots, and only once."""
    owners = table(0, NO_OWNER, 2, 3)
    ways: list[tuple[tuple[float, ...], ...]] = []
    for without_plan, silent in ((1, 0), (0, 1)):
        search = Search()
        for _ in range(10):
            now = situation(owners, (0.0, 0.0))
            search = advance(search, now, PLAN, strangers=0, silent=silent, without_plan=without_plan)
            if search.way:
                break
        ways.append(search.way)
    assert ways == [(PLAN.points[1], CENTER), (PLAN.points[1],)]


def test_body_standing_at_a_place_is_remembered_out_of_sight() -> None:
    """Its witnesses are too few to call the place blocked. Out of sight, it was vacant again: a search without end."""
    live = cast(
        "Any",
        SimpleNamespace(strangers=set[int](), silent={1}, without_plan=set[int](), present={0, 2, 3}, time_out=10),
    )
    recovery = ConnectivityRecovery(live, cast("Any", SimpleNamespace(waiting=False)))
    owners, (x, y) = table(0, NO_OWNER, 2, 3), PLAN.points[1]

    def looks_for(here: Point, *bodies: Point) -> tuple[int, ...]:
        recovery.route(situation(owners, here, *bodies), placed=False)
        return recovery._search.known[1]

    assert looks_for(PLAN.points[0], (x, y)) == ()
    away = (x - 4 * MISSION.sensing, y)
    assert {looks_for(away) for _ in range(REMEMBERED)} == {()}, "it stands there still"
    assert looks_for(away) == (1,), "its witnesses may be too few: somebody else has to come and see it"
    assert looks_for(PLAN.points[0], (x, y)) == ()
    assert looks_for(PLAN.points[0]) == (1,), "it is seen to be gone"
    assert looks_for((x - 4 * MISSION.sensing, y)) == (1,)


@pytest.mark.parametrize(("liars", "misses"), [(0, True), (1, True), (2, False)])
def test_placeless_robots_are_missed_unless_they_may_be_liars(liars: int, misses: bool) -> None:
    """Liars pass on heartbeats and nothing else, so no robot is silent. In touch, vacant places would be taken."""
    nobody = set[int]()
    live = cast(
        "Any", SimpleNamespace(strangers=nobody, silent=nobody, without_plan=nobody, present={0, 1, 2, 3}, time_out=10)
    )

    def looks(rounds: int, *owners: int) -> bool:
        recovery = ConnectivityRecovery(live, cast("Any", SimpleNamespace(waiting=False)), liars)
        for _ in range(rounds):
            recovery.route(situation(table(*owners), PLAN.points[0]), placed=False)
        return bool(recovery._search.way)

    assert not looks(10 + APART, 0, NO_OWNER, NO_OWNER, 3)
    assert looks(10 + APART + 9, 0, NO_OWNER, NO_OWNER, 3) == misses
    assert not looks(10 + APART + 9, 0, 1, 2, 3)


def test_place_with_a_standing_body_is_not_searched() -> None:
    """Its robot is out of radio range, or not heard for the loss of messages; it needs no visit."""
    owners = table(0, NO_OWNER, 2, 3)
    search = Search()
    for _ in range(30):
        search = advance(search, situation(owners, (0.0, 0.0)), PLAN, strangers=1, silent=0, standing={1})
        assert search.target is None
