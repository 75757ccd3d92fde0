"""The search that ends frozen partitions: which robot goes, where, and when it stops."""

from functools import partial
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
    advance,
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
