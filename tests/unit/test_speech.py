"""What is said in full and when: to newcomers, where digests differ, and only as much as somebody may lack."""

from __future__ import annotations

import json

import numpy as np
import pytest
from crew import Crew, connected_places
from msgspec.structs import replace

from llm_flock.mission import Mission
from llm_flock.protocol.membership.liveness import Liveness
from llm_flock.protocol.messages.codec import decode
from llm_flock.protocol.messages.dissemination import MISSION_FIELDS, SMALL, Dissemination, mission_text
from llm_flock.protocol.messages.message import (
    UNSAID,
    BidEntry,
    BidTable,
    Message,
    MissionStamp,
    Provenance,
    table_digest,
)
from llm_flock.protocol.plan import Plan

WIDE = ((-5000.0, -5000.0), (5000.0, 5000.0))
MISSION = Mission(shape="circle", n_robots=3, arena=WIDE)
LARGE = Mission(shape="circle", n_robots=SMALL + 2, arena=WIDE)
NOBODY = frozenset[int]()


def plan_of(mission: Mission, turn: float = 0.0) -> Plan:
    assert mission.ideal is not None
    return Plan.of([[x + turn, y - turn] for x, y in mission.ideal])


def table_of(mission: Mission, **owned: BidEntry) -> BidTable:
    """A table with these entries, `s3` for slot 3."""
    entries = [UNSAID] * mission.n_places
    for name, entry in owned.items():
        entries[int(name[1:])] = entry
    return tuple(entries)


def standing(
    mission: Mission = MISSION,
    sender: int = 0,
    plan: Plan | None = None,
    table: BidTable | None = None,
    counter: int = 0,
    slot: int | None = None,
) -> Message:
    """A robot's whole standing, by default with one plan and an empty table."""
    plan = plan_of(mission) if plan is None else plan
    origin = Provenance(mission=counter, mission_digest=mission.digest, epoch=0, neighbors=1, proposer=0, sequence=0)
    return Message(
        sender=sender,
        sequence=0,
        neighbors=1,
        mission=MissionStamp(counter, mission.digest),
        plan=plan,
        provenance=origin,
        slot=slot,
        table=table_of(mission) if table is None else table,
    )


class Talker:
    """One robot's dissemination, and what its neighbours understand."""

    def __init__(self, mission: Mission = MISSION, around: frozenset[int] = NOBODY) -> None:
        self.mission, self.dissemination = mission, Dissemination()
        self.liveness = Liveness(0, mission.n_robots, 10)
        self.around = around
        self.begin()

    def begin(self, around: frozenset[int] | None = None, neighbors: int | None = None) -> None:
        self.around = self.around if around is None else around
        self.dissemination.begin_round(self.around, len(self.around) if neighbors is None else neighbors)

    def say(self, whole: Message) -> Message:
        payload = self.dissemination.say(whole, self.mission, self.liveness)
        return decode(payload, self.mission.n_robots, self.mission.dim)


def said_slots(message: Message) -> set[int]:
    assert message.table is not None
    return {a for a, entry in enumerate(message.table) if entry != UNSAID}


def test_a_greeting_says_everything_and_what_follows_only_names_it() -> None:
    talker = Talker(around=frozenset({1}))
    table = table_of(MISSION, s1=(0, -2.0, 0))
    first = talker.say(standing(table=table, slot=1))
    assert first.plan == plan_of(MISSION) and first.table == table and first.beats is not None
    second = talker.say(standing(table=table, slot=1))
    assert second.plan is None and second.beats is None
    assert second.plan_digest == plan_of(MISSION).digest and second.places == 3
    assert second.table_digest == first.table_digest == table_digest(table)
    assert second.slot == 1 and said_slots(second) == {1}, "the own claim is always said"


def test_who_agrees_needs_no_greeting_in_a_large_team_and_a_newcomer_does() -> None:
    talker = Talker(LARGE, frozenset({1}))
    talker.say(standing(LARGE))
    talker.dissemination.hear(standing(LARGE, sender=1))
    talker.begin()
    greeting = talker.say(standing(LARGE))
    assert greeting.plan is None and said_slots(greeting) == set() and greeting.beats is not None
    talker.dissemination.hear(standing(LARGE, sender=1))
    talker.begin(frozenset({1, 2}))
    assert talker.say(standing(LARGE)).plan is not None, "robot 2 is near and was not heard"
    talker.dissemination.hear(standing(LARGE, sender=1))
    talker.begin(frozenset({1}), neighbors=2)
    assert talker.say(standing(LARGE)).plan is not None, "the radio counts somebody whom no sensor sees"


def test_what_was_said_is_repeated_only_while_nothing_is_new() -> None:
    """One thing after the other is new, each is said, and then the same bytes do again."""
    talker = Talker(LARGE, frozenset({1}))
    claims, changed = table_of(LARGE), table_of(LARGE, s3=(0, -1.0, 0))

    def settle(whole: Message, claim: object) -> int:
        """Exchanges until the bytes repeat themselves."""
        for count in range(6):
            if talker.dissemination.again(claim) is not None:
                return count
            talker.say(whole)
        raise AssertionError("the bytes are made anew in every exchange")

    whole = standing(LARGE, table=claims)
    assert settle(whole, claims) == 2, "a greeting, and what follows it"
    assert talker.dissemination.again(claims) == talker.dissemination.again(claims)
    talker.begin()
    assert settle(whole, claims) == 2, "another round"
    whole = standing(LARGE, table=changed)
    assert settle(whole, changed) == 3, "a change is said twice, and then no more"
    talker.dissemination.hear(standing(LARGE, sender=1, table=changed))
    assert settle(whole, changed) == 1, "a neighbour"
    talker.dissemination.hear(standing(LARGE, sender=1, table=changed, slot=2))
    assert settle(whole, changed) == 0, "a neighbour that knows no more and no less than before"
    talker.dissemination.hear(standing(LARGE, sender=1, plan=plan_of(LARGE, 1.0), table=changed))
    assert settle(whole, changed) == 1, "a neighbour on another plan"
    assert talker.dissemination.again(claims) is None, "another claim"


def test_a_roll_is_said_once() -> None:
    talker = Talker()
    talker.say(standing())
    talker.say(standing())
    assert talker.dissemination.again() is not None
    talker.say(replace(standing(), positions={0: (0, (1.0, 2.0), ())}))
    assert talker.dissemination.again() is None


def test_in_a_small_team_every_round_begins_with_a_greeting() -> None:
    talker = Talker(around=frozenset({1}))
    talker.say(standing())
    talker.dissemination.hear(standing(sender=1))
    talker.begin()
    assert talker.say(standing()).plan is not None


def test_who_was_not_heard_in_a_round_is_met_anew() -> None:
    talker = Talker(LARGE, frozenset({1}))
    talker.dissemination.hear(standing(LARGE, sender=1))
    talker.begin()
    talker.say(standing(LARGE))
    talker.begin()
    assert talker.say(standing(LARGE)).plan is not None


def test_a_plan_is_spelled_out_when_it_was_just_taken_up_and_to_who_follows_another() -> None:
    talker, new = Talker(), plan_of(MISSION, 1.0)
    talker.say(standing())
    talker.dissemination.hear(standing(sender=1))
    assert talker.say(standing()).plan is None
    assert talker.say(standing(plan=new)).plan == new, "robot 1 names another one, and it was just taken up"
    talker.dissemination.hear(standing(sender=1, plan=new))
    assert talker.say(standing(plan=new)).plan is None
    talker.dissemination.hear(standing(sender=1))
    assert talker.say(standing(plan=new)).plan == new
    assert talker.say(standing(plan=new)).plan == new, "until it names the same: what was said may be lost"


def test_a_plan_just_taken_up_is_passed_on_whoever_is_known_to_follow_it() -> None:
    talker, new = Talker(), plan_of(MISSION, 1.0)
    talker.say(standing())
    talker.dissemination.hear(standing(sender=1, plan=new))
    assert talker.say(standing(plan=new)).plan == new


def test_a_mission_is_spelled_out_only_for_who_lags_behind() -> None:
    old, new = MISSION, MISSION.change(shape="line", since=3)
    talker = Talker(new)
    ahead = standing(new, counter=1)
    assert talker.say(ahead).mission_text is None, "nobody is known to need it"
    talker.dissemination.hear(standing(old, sender=1))
    text = talker.say(ahead).mission_text
    assert text is not None and old.change(**json.loads(text)) == new
    talker.dissemination.hear(standing(new, sender=1, counter=1))
    assert talker.say(ahead).mission_text is None
    talker.dissemination.hear(standing(old, sender=2, counter=2))
    assert talker.say(ahead).mission_text is None, "robot 2 is ahead"


def test_a_mission_is_said_without_what_is_a_robots_own() -> None:
    assert set(json.loads(mission_text(MISSION))) == MISSION_FIELDS
    own = {"n_robots", "safe_distance", "max_step", "comm_range", "sense_range", "arena", "obstacles"}
    assert set(Mission.model_fields) - MISSION_FIELDS == own


@pytest.mark.parametrize(("mission", "whole"), [(MISSION, True), (LARGE, False)])
def test_where_digests_differ_small_tables_are_spelled_out_and_large_ones_once_a_round(
    mission: Mission, whole: bool
) -> None:
    talker = Talker(mission)
    table = table_of(mission, s0=(0, -1.0, 1), s2=(0, -2.0, 0))
    talker.say(standing(mission, table=table, slot=2))
    for _ in range(3):  # those whose slots changed are said twice
        talker.say(standing(mission, table=table, slot=2))
    talker.dissemination.hear(standing(mission, sender=1))
    expected = {0, 2} if whole else {2}
    assert said_slots(talker.say(standing(mission, table=table, slot=2))) == expected
    talker.begin()
    assert said_slots(talker.say(standing(mission, table=table, slot=2))) == {0, 2}
    other = standing(mission, sender=1, plan=plan_of(mission, 1.0))
    talker.dissemination.hear(other)
    assert said_slots(talker.say(standing(mission, table=table, slot=2))) == {2}, "claims on another plan mean nothing"


def test_what_changed_in_a_large_table_is_said_in_two_broadcasts() -> None:
    talker = Talker(LARGE)
    entries: dict[str, BidEntry] = {"s0": (0, -1.0, 1)}
    talker.say(standing(LARGE, table=table_of(LARGE, **entries)))
    said: list[set[int]] = []
    for slot in (5, 7, None, None):
        if slot is not None:
            entries[f"s{slot}"] = (1, -3.0, 2)
        said.append(said_slots(talker.say(standing(LARGE, table=table_of(LARGE, **entries)))))
    assert said == [{5}, {5, 7}, {7}, set()]


def test_without_a_table_or_a_plan_there_is_little_to_say() -> None:
    talker = Talker()
    bare = Message(sender=0, sequence=0, neighbors=1, mission=MissionStamp(0, MISSION.digest))
    said = talker.say(bare)
    assert said.plan is said.table is said.plan_digest is said.table_digest is None and said.places == 0


def test_sequence_numbers_count_what_is_new() -> None:
    talker = Talker()
    first, second, third = (talker.say(standing()) for _ in range(3))
    assert (first.sequence, second.sequence, third.sequence) == (0, 1, 1) and second == third


def test_a_team_of_ten_that_agrees_says_a_few_dozen_bytes() -> None:
    mission = Mission(shape="circle", n_robots=10, arena=WIDE)
    rng = np.random.default_rng(4)
    crew = Crew(mission, connected_places(10, rng), rng, time_out=1000)
    sizes: list[list[int]] = []
    broadcast = crew.transport.broadcast

    def spy(payload: bytes, receivers: tuple[int, ...]) -> None:
        sizes.append([crew.number, len(payload)])
        broadcast(payload, receivers)

    crew.transport.broadcast = spy
    crew.rounds(14)
    said = [size for number, size in sizes if number == 14]
    comm_rounds = [said[k : k + 10] for k in range(0, len(said), 10)]
    assert len(comm_rounds) == 5
    assert max(comm_rounds[0]) > 250, "the greeting"
    assert max(map(max, comm_rounds[1:])) < 90, max(map(max, comm_rounds[1:]))
