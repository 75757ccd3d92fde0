"""Heartbeats and missions in flight, whatever happens to the messages: real agents, driven by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from crew import PERFECT, WIDE, Crew, a_leaf, assert_at_rest, connected_places
from effort import cases
from hypothesis import example, given
from hypothesis import strategies as st

from llm_flock.mission import Mission
from llm_flock.protocol.messages import dissemination
from llm_flock.protocol.messages.codec import encode
from llm_flock.protocol.messages.message import BLOCKED, Message, MissionStamp
from llm_flock.protocol.messages.mission_update import MISSION_FIELDS
from llm_flock.transport.memory import LinkFaults

FAULTS = st.builds(
    LinkFaults, loss=st.floats(0, 0.5), delay=st.integers(0, 3), duplicate=st.floats(0, 0.5), reorder=st.floats(0, 1)
)
SEEDS = st.integers(0, 2**32)
CALM = 12
"""Rounds of five exchanges without faults in which a team of eight comes to rest."""


def circle(n: int, **fields: Any) -> Mission:
    return Mission(shape="circle", n_robots=n, arena=WIDE, **fields)


def slots(crew: Crew) -> list[int]:
    return sorted(agent.claim.slot for agent in crew.active if agent.claim.slot is not None)


@cases(6)
@given(seed=SEEDS, n=st.integers(1, 6), faults=FAULTS, when=st.integers(1, 8))
def test_a_mission_given_to_any_one_robot_reaches_all(seed: int, n: int, faults: LinkFaults, when: int) -> None:
    rng = np.random.default_rng(seed)
    crew = Crew(circle(n), connected_places(n, rng), rng, faults, time_out=1000)
    crew.rounds(when)
    given = crew.mission.change(shape="line", center=(40.0, 60.0), since=when + 1)
    crew.round({int(rng.integers(n)): given})
    crew.rounds(40)
    assert_at_rest(crew)
    assert slots(crew) == list(range(n))
    assert all(agent.mission == given for agent in crew.active)


@cases(6)
@given(seed=SEEDS, n=st.integers(2, 6), faults=FAULTS, later=st.integers(0, 3))
def test_of_two_missions_given_to_two_robots_all_end_on_the_same_one(
    seed: int, n: int, faults: LinkFaults, later: int
) -> None:
    rng = np.random.default_rng(seed)
    crew = Crew(circle(n), connected_places(n, rng), rng, faults, time_out=1000)
    crew.rounds(3)
    first, second = (int(robot) for robot in rng.permutation(n)[:2])
    one, other = crew.mission.change(shape="line", since=4), crew.mission.change(center=(60.0, 50.0), since=4 + later)
    if later:
        crew.round({first: one})
        crew.rounds(later - 1)
        crew.round({second: other})
    else:
        crew.round({first: one, second: other})
    crew.rounds(40)
    assert_at_rest(crew)
    assert slots(crew) == list(range(n))
    assert crew.agents[0].mission in (one, other)
    if not later:
        assert crew.agents[0].mission.digest == max(one.digest, other.digest)


@cases(6)
@given(seed=SEEDS, n=st.integers(3, 6), faults=FAULTS, comes_back=st.sampled_from(["anew", "as it was"]))
@example(  # two that live stand for ever beside the place that the silent one's body had blocked
    seed=996,
    n=6,
    faults=LinkFaults(loss=0.48046875, delay=2, duplicate=0.294921875, reorder=0.2421875),
    comes_back="anew",
)
def test_the_place_of_a_silent_robot_is_free_and_when_it_returns_all_have_one(
    seed: int, n: int, faults: LinkFaults, comes_back: str
) -> None:
    rng = np.random.default_rng(seed)
    places = connected_places(n, rng)
    crew = Crew(circle(n), places, rng, faults)
    lost = a_leaf(places, crew.mission.comm_range, int(rng.integers(n)))
    crew.rounds(6)
    before = crew.agents[lost]
    (crew.silent if comes_back == "anew" else crew.cut_off).add(lost)
    crew.rounds(8)
    crew.set_faults(PERFECT)
    crew.rounds(CALM)
    crew.silent.add(lost)  # it does not count among those that are awake
    assert_at_rest(crew)
    assert len(slots(crew)) == n - 1
    table = crew.active[0].claim.table
    assert table is not None and not any(owner == lost for _, _, owner in table)
    crew.silent.discard(lost)
    crew.cut_off.discard(lost)
    if comes_back == "anew":
        crew.wake(lost)
    else:
        assert crew.agents[lost] is before
    crew.set_faults(faults)
    crew.rounds(8)
    crew.set_faults(PERFECT)
    crew.rounds(CALM)
    assert_at_rest(crew)
    assert slots(crew) == list(range(n))


@cases(6)
@given(seed=SEEDS, n=st.integers(2, 7), faults=FAULTS, changes=st.booleans())
def test_a_late_joiner_finds_the_free_place_of_the_mission_in_force(
    seed: int, n: int, faults: LinkFaults, changes: bool
) -> None:
    rng = np.random.default_rng(seed)
    places = connected_places(n, rng)
    late = a_leaf(places, 15.0, int(rng.integers(n)))
    crew = Crew(circle(n), places, rng, faults, asleep=[late])
    crew.rounds(6)
    if changes:
        crew.round({int(rng.choice(crew.awake)): crew.mission.change(shape="line", since=7)})
        crew.rounds(6)
    crew.wake(late)
    crew.rounds(8)
    crew.set_faults(PERFECT)
    crew.rounds(CALM)
    assert_at_rest(crew)
    assert slots(crew) == list(range(n))
    assert {agent.mission.shape for agent in crew.active} == {"line" if changes else "circle"}


@cases(6)
@given(seed=SEEDS, n=st.integers(2, 7), share=st.floats(0.1, 0.99), faults=FAULTS)
def test_with_more_robots_than_places_every_place_has_one_owner_and_the_others_none(
    seed: int, n: int, share: float, faults: LinkFaults
) -> None:
    rng = np.random.default_rng(seed)
    count = max(1, int(share * n))
    crew = Crew(circle(n, places=count), connected_places(n, rng), rng, faults, time_out=1000)
    crew.rounds(50)
    assert_at_rest(crew)
    assert slots(crew) == list(range(count))


@cases(5)
@given(seed=SEEDS, n=st.integers(2, 6), faults=FAULTS)
def test_a_plan_is_remade_for_those_that_are_left_and_again_for_all(seed: int, n: int, faults: LinkFaults) -> None:
    rng = np.random.default_rng(seed)
    places = connected_places(n, rng)
    crew = Crew(circle(n), places, rng, faults, gaps="replan")
    lost = a_leaf(places, crew.mission.comm_range, int(rng.integers(n)))
    crew.rounds(6)
    crew.silent.add(lost)
    crew.rounds(8)
    crew.set_faults(PERFECT)
    crew.rounds(2 * CALM)
    table = crew.active[0].claim.table
    assert table is not None
    if not any(owner == BLOCKED for _, _, owner in table):  # the team's stand-in plans do not keep off bodies
        assert_at_rest(crew)
        assert slots(crew) == list(range(n - 1)) and len(table) == n - 1
    crew.wake(lost)
    crew.rounds(2 * CALM)
    assert_at_rest(crew)
    assert slots(crew) == list(range(n))


LIMITS: dict[str, Any] = {
    "n_robots": 3,
    "safe_distance": 0.5,
    "max_step": 60.0,
    "comm_range": 500.0,
    "sense_range": 500.0,
    "arena": ((-900.0, -900.0), (900.0, 900.0)),
    "obstacles": ({"center": (400.0, 400.0), "radius": 1.0},),
}


@cases(6)
@given(
    seed=SEEDS,
    changed=st.sets(st.sampled_from(sorted(LIMITS)), min_size=1),
    counter=st.integers(0, 2**39),
    spelled=st.booleans(),
)
def test_no_mission_over_the_radio_changes_what_is_a_robots_own(
    seed: int, changed: set[str], counter: int, spelled: bool
) -> None:
    """Said with its limits it is malformed; without them it is not the mission that its digest stands for."""
    rng = np.random.default_rng(seed)
    n = 4
    crew = Crew(circle(n), connected_places(n, rng), rng, time_out=1000)
    evil = crew.mission.change(center=(51.0, 50.0), **{field: LIMITS[field] for field in changed})
    fields = MISSION_FIELDS | (changed if spelled else set())
    stamp = MissionStamp(counter, evil.digest)
    attack = Message(
        sender=3, sequence=0, neighbors=3, mission=stamp, mission_text=evil.model_dump_json(include=set(fields))
    )
    hidden = Message(sender=3, sequence=0, neighbors=3, mission=stamp)
    crew.silent.add(3)
    for _ in range(12):
        crew.round(junk=[encode(attack), encode(hidden)])
    higher = stamp > MissionStamp(0, crew.mission.digest)
    for agent in crew.active:
        assert agent.mission == crew.mission
    reason = "malformed" if spelled else "other_mission"
    assert_at_rest(crew, rejected={reason: 60} if higher else {})
    assert len(slots(crew)) == n - 1


@cases(6)
@given(seed=SEEDS, n=st.integers(2, 6), faults=FAULTS, spare=st.integers(0, 3))
def test_what_large_teams_leave_out_of_their_messages_does_not_matter(
    seed: int, n: int, faults: LinkFaults, spare: int
) -> None:
    """A table of more than two places counts as large here: it is mostly said by its changes."""
    rng = np.random.default_rng(seed)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dissemination, "SMALL", 2)
        count = max(1, n - spare)
        crew = Crew(circle(n, places=count), connected_places(n, rng), rng, faults, time_out=1000)
        crew.rounds(40)
        assert_at_rest(crew)
        assert slots(crew) == list(range(count))
        given = crew.mission.change(shape="line", since=41)
        crew.round({int(rng.integers(n)): given})
        crew.rounds(40)
        assert_at_rest(crew)
        assert slots(crew) == list(range(count)) and crew.agents[0].mission == given
