"""Heartbeats and missions with lost, late and repeated messages: real agents, driven by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from effort import cases
from hypothesis import example, given
from hypothesis import strategies as st
from still_team import PERFECT, WIDE, StillTeam, a_leaf, assert_at_rest, connected_places

from llm_flock.links import LinkFaults
from llm_flock.message import BLOCKED, Message, MissionStamp, encode
from llm_flock.mission import MISSION_FIELDS, Mission
from llm_flock.protocol._messages import dissemination

FAULTS = st.builds(
    LinkFaults, loss=st.floats(0, 0.5), delay=st.integers(0, 3), duplicate=st.floats(0, 0.5), reorder=st.floats(0, 1)
)
SEEDS = st.integers(0, 2**32)
CALM = 12
"""Rounds of five exchanges without faults in which a team of eight comes to rest."""


def circle(n: int, **fields: Any) -> Mission:
    return Mission(shape="circle", n_robots=n, arena=WIDE, **fields)


def slots(team: StillTeam) -> list[int]:
    return sorted(agent.claim.slot for agent in team.active if agent.claim.slot is not None)


@cases(3)
@given(seed=SEEDS, n=st.integers(1, 6), faults=FAULTS, when=st.integers(1, 8))
def test_a_mission_given_to_any_one_robot_reaches_all(seed: int, n: int, faults: LinkFaults, when: int) -> None:
    rng = np.random.default_rng(seed)
    team = StillTeam(circle(n), connected_places(n, rng), rng, faults, time_out=1000)
    team.rounds(when)
    given = team.mission.change(shape="line", center=(40.0, 60.0), since=when + 1)
    team.round({int(rng.integers(n)): given})
    team.rounds(40)
    assert_at_rest(team)
    assert slots(team) == list(range(n))
    assert all(agent.mission == given for agent in team.active)


@cases(3)
@given(seed=SEEDS, n=st.integers(2, 6), faults=FAULTS, later=st.integers(0, 3))
def test_all_end_on_the_later_of_missions_given_to_two_robots(
    seed: int, n: int, faults: LinkFaults, later: int
) -> None:
    rng = np.random.default_rng(seed)
    team = StillTeam(circle(n), connected_places(n, rng), rng, faults, time_out=1000)
    team.rounds(3)
    first, second = (int(robot) for robot in rng.permutation(n)[:2])
    one, other = team.mission.change(shape="line", since=4), team.mission.change(center=(60.0, 50.0), since=4 + later)
    if later:
        team.round({first: one})
        team.rounds(later - 1)
        team.round({second: other})
    else:
        team.round({first: one, second: other})
    team.rounds(40)
    assert_at_rest(team)
    assert slots(team) == list(range(n))
    assert team.agents[0].mission == other


@cases(3)
@given(seed=SEEDS, n=st.integers(3, 6), faults=FAULTS, earlier=st.integers(1, 4))
def test_last_order_is_flown_however_many_were_given_elsewhere(
    seed: int, n: int, faults: LinkFaults, earlier: int
) -> None:
    """A robot that is cut off gets the last order, after the others got several; and the reverse."""
    rng = np.random.default_rng(seed)
    team = StillTeam(circle(n), connected_places(n, rng), rng, faults, time_out=1000)
    team.rounds(2)
    alone, taker = (int(robot) for robot in rng.permutation(n)[:2])
    last = team.mission.change(shape="line", since=3 + earlier)
    for alone_is_last in (True, False):
        team.cut_off = {alone}
        for k in range(earlier):
            order = team.mission.change(center=(60.0 + k, 50.0), since=team.number + 1)
            team.round({(taker if alone_is_last else alone): order})
        last = team.mission.change(shape="line", center=(50.0 + alone_is_last, 50.0), since=team.number + 1)
        team.round({(alone if alone_is_last else taker): last})
        team.cut_off = set()
        team.rounds(40)
        assert_at_rest(team)
        assert team.agents[0].mission == last


@cases(3)
@given(seed=SEEDS, n=st.integers(3, 6), faults=FAULTS, comes_back=st.sampled_from(["restarted", "as it was"]))
@example(  # two that live stand without end beside the place that the silent one's body had blocked
    seed=996,
    n=6,
    faults=LinkFaults(loss=0.48046875, delay=2, duplicate=0.294921875, reorder=0.2421875),
    comes_back="restarted",
)
def test_silent_robot_loses_its_place_and_returns_to_one(
    seed: int, n: int, faults: LinkFaults, comes_back: str
) -> None:
    rng = np.random.default_rng(seed)
    places = connected_places(n, rng)
    team = StillTeam(circle(n), places, rng, faults)
    lost = a_leaf(places, team.mission.comm_range, int(rng.integers(n)))
    team.rounds(6)
    before = team.agents[lost]
    (team.silent if comes_back == "restarted" else team.cut_off).add(lost)
    team.rounds(8)
    team.set_faults(PERFECT)
    team.rounds(CALM)
    team.silent.add(lost)  # it does not count among those that are awake
    assert_at_rest(team)
    assert len(slots(team)) == n - 1
    table = team.active[0].claim.table
    assert table is not None and not any(owner == lost for _, _, owner in table)
    team.silent.discard(lost)
    team.cut_off.discard(lost)
    if comes_back == "restarted":
        team.wake(lost)
    else:
        assert team.agents[lost] is before
    team.set_faults(faults)
    team.rounds(8)
    team.set_faults(PERFECT)
    team.rounds(CALM)
    assert_at_rest(team)
    assert slots(team) == list(range(n))


@cases(3)
@given(seed=SEEDS, n=st.integers(2, 7), faults=FAULTS, changes=st.booleans())
def test_late_joiner_finds_the_free_place_of_current_mission(
    seed: int, n: int, faults: LinkFaults, changes: bool
) -> None:
    rng = np.random.default_rng(seed)
    places = connected_places(n, rng)
    late = a_leaf(places, 15.0, int(rng.integers(n)))
    team = StillTeam(circle(n), places, rng, faults, asleep=[late])
    team.rounds(6)
    if changes:
        team.round({int(rng.choice(team.awake)): team.mission.change(shape="line", since=7)})
        team.rounds(6)
    team.wake(late)
    team.rounds(8)
    team.set_faults(PERFECT)
    team.rounds(CALM)
    assert_at_rest(team)
    assert slots(team) == list(range(n))
    assert {agent.mission.shape for agent in team.active} == {"line" if changes else "circle"}


@cases(3)
@given(seed=SEEDS, n=st.integers(2, 7), share=st.floats(0.1, 0.99), faults=FAULTS)
def test_every_place_has_one_owner_and_spare_robots_have_none(
    seed: int, n: int, share: float, faults: LinkFaults
) -> None:
    rng = np.random.default_rng(seed)
    count = max(1, int(share * n))
    team = StillTeam(circle(n, places=count), connected_places(n, rng), rng, faults, time_out=1000)
    team.rounds(50)
    assert_at_rest(team)
    assert slots(team) == list(range(count))


@cases(3)
@given(seed=SEEDS, n=st.integers(2, 6), faults=FAULTS)
def test_team_replans_for_the_robots_left_and_again_for_all(seed: int, n: int, faults: LinkFaults) -> None:
    rng = np.random.default_rng(seed)
    places = connected_places(n, rng)
    team = StillTeam(circle(n), places, rng, faults, gaps="replan")
    lost = a_leaf(places, team.mission.comm_range, int(rng.integers(n)))
    team.rounds(6)
    team.silent.add(lost)
    team.rounds(8)
    team.set_faults(PERFECT)
    team.rounds(2 * CALM)
    table = team.active[0].claim.table
    assert table is not None
    if not any(owner == BLOCKED for _, _, owner in table):  # the team's stand-in plans do not keep off bodies
        assert_at_rest(team)
        assert slots(team) == list(range(n - 1)) and len(table) == n - 1
    team.wake(lost)
    team.rounds(2 * CALM)
    assert_at_rest(team)
    assert slots(team) == list(range(n))


LIMITS: dict[str, Any] = {
    "n_robots": 3,
    "safe_distance": 0.5,
    "max_step": 60.0,
    "comm_range": 500.0,
    "sense_range": 500.0,
    "arena": ((-900.0, -900.0), (900.0, 900.0)),
    "obstacles": ({"center": (400.0, 400.0), "radius": 1.0},),
}


@cases(3)
@given(
    seed=SEEDS,
    changed=st.sets(st.sampled_from(sorted(LIMITS)), min_size=1),
    counter=st.integers(0, 2**39),
    spelled=st.booleans(),
)
def test_no_mission_over_the_radio_changes_a_robots_limits(
    seed: int, changed: set[str], counter: int, spelled: bool
) -> None:
    """Said with its limits it is malformed; without them it is not the mission that its digest stands for."""
    rng = np.random.default_rng(seed)
    n = 4
    team = StillTeam(circle(n), connected_places(n, rng), rng, time_out=1000)
    evil = team.mission.change(center=(51.0, 50.0), **{field: LIMITS[field] for field in changed})
    fields = MISSION_FIELDS | (changed if spelled else set())
    stamp = MissionStamp(counter, evil.digest)
    attack = Message(
        sender=3, sequence=0, degree=3, stamp=stamp, mission_text=evil.model_dump_json(include=set(fields))
    )
    hidden = Message(sender=3, sequence=0, degree=3, stamp=stamp)
    team.silent.add(3)
    for _ in range(12):
        team.round(junk=[encode(attack), encode(hidden)])
    higher = stamp > MissionStamp(0, team.mission.digest)
    for agent in team.active:
        assert agent.mission == team.mission
    reason = "malformed" if spelled else "other_mission"
    assert_at_rest(team, rejected={reason: 60} if higher else {})
    assert len(slots(team)) == n - 1


@cases(3)
@given(seed=SEEDS, n=st.integers(2, 6), faults=FAULTS, spare=st.integers(0, 3))
def test_a_team_with_partial_tables_comes_to_rest(seed: int, n: int, faults: LinkFaults, spare: int) -> None:
    """A table of more than two places counts as large here: it is mostly said by its changes."""
    rng = np.random.default_rng(seed)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dissemination, "SMALL", 2)
        count = max(1, n - spare)
        team = StillTeam(circle(n, places=count), connected_places(n, rng), rng, faults, time_out=1000)
        team.rounds(40)
        assert_at_rest(team)
        assert slots(team) == list(range(count))
        given = team.mission.change(shape="line", since=41)
        team.round({int(rng.integers(n)): given})
        team.rounds(40)
        assert_at_rest(team)
        assert slots(team) == list(range(count)) and team.agents[0].mission == given
