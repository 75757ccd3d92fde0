"""Dissemination: what a message spells out for newcomers and for neighbours whose digests differ."""

from __future__ import annotations

import json

import numpy as np
import pytest
from msgspec.structs import replace
from still_team import StillTeam, connected_places
from tables import told

from llm_flock.message import UNSAID, BidEntry, BidTable, Message, MissionStamp, Provenance, decode, table_digest
from llm_flock.mission import MISSION_FIELDS, OPTIONAL, Mission, mission_text
from llm_flock.plan import Plan
from llm_flock.protocol._membership.liveness import Liveness
from llm_flock.protocol._messages.dissemination import RESTLESS_ROUNDS, SMALL, Dissemination

WIDE = ((-5000.0, -5000.0), (5000.0, 5000.0))
MISSION = Mission(shape="circle", n_robots=3, arena=WIDE)
LARGE = Mission(shape="circle", n_robots=SMALL + 2, arena=WIDE)


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
    """A robot's whole knowledge, by default with one plan and an empty table."""
    plan = plan_of(mission) if plan is None else plan
    origin = Provenance(mission=counter, mission_digest=mission.digest, epoch=0, degree=1, proposer=0, sequence=0)
    return Message(
        sender=sender,
        sequence=0,
        degree=1,
        stamp=MissionStamp(counter, mission.digest),
        plan=plan,
        provenance=origin,
        slot=slot,
        **told(table_of(mission) if table is None else table),
    )


class Sender:
    """One robot's dissemination, and the messages that its neighbours decode."""

    def __init__(self, mission: Mission = MISSION) -> None:
        self.mission, self.dissemination = mission, Dissemination()
        self.liveness = Liveness(0, mission.n_robots, 10)
        self.begin()

    def begin(self) -> None:
        self.dissemination.begin_round()

    def send(self, whole: Message) -> Message:
        beats = self.liveness.beats if self.dissemination.greets else None
        payload = self.dissemination.compose(replace(whole, beats=beats), whole.table, self.mission)
        return decode(payload, self.mission.n_robots, self.mission.dim)


def slots_of(message: Message) -> set[int]:
    assert message.table is not None
    return {a for a, entry in enumerate(message.table) if entry != UNSAID}


def test_greeting_spells_out_everything_later_messages_name_it() -> None:
    sender = Sender()
    table = table_of(MISSION, s1=(0, -2.0, 0))
    first = sender.send(standing(table=table, slot=1))
    assert first.plan == plan_of(MISSION) and first.table == table and first.beats is not None
    second = sender.send(standing(table=table, slot=1))
    assert second.plan is None and second.beats is None
    assert second.plan_digest == plan_of(MISSION).digest and second.places == 3
    assert second.table_digest == first.table_digest == table_digest(table)
    assert second.slot == 1 and slots_of(second) == {1}, "the own claim is always spelled out"


def test_large_team_tells_newcomers_only_what_they_lack() -> None:
    sender, table = Sender(LARGE), table_of(LARGE, s1=(0, -2.0, 0))
    whole = standing(LARGE, table=table)
    for _ in range(3):
        sender.send(whole)
    sender.begin()
    greeting = sender.send(whole)
    assert greeting.plan is None and slots_of(greeting) == set() and greeting.beats is not None
    sender.dissemination.hear(standing(LARGE, sender=1, table=table))
    assert sender.send(whole).plan is None, "it knows as much"
    sender.dissemination.hear(standing(LARGE, sender=2, plan=plan_of(LARGE, 1.0), table=table))
    answers = [sender.send(whole).plan is not None for _ in range(4)]
    assert answers == [True, False, True, False], "its answer is heard before the next broadcast but one"


def test_in_a_small_team_every_round_begins_with_a_greeting() -> None:
    sender = Sender()
    sender.send(standing())
    sender.dissemination.hear(standing(sender=1))
    sender.begin()
    assert sender.send(standing()).plan is not None


def test_a_neighbour_that_was_silent_for_a_round_is_forgotten() -> None:
    sender = Sender(LARGE)
    for _ in range(2):
        sender.send(standing(LARGE))
    sender.dissemination.hear(standing(LARGE, sender=1, plan=plan_of(LARGE, 1.0)))
    sender.begin()
    assert sender.send(standing(LARGE)).plan is not None, "it may still be there"
    sender.send(standing(LARGE))
    sender.begin()
    assert sender.send(standing(LARGE)).plan is None


def test_plan_is_spelled_out_when_new_or_neighbours_differ() -> None:
    sender, new = Sender(), plan_of(MISSION, 1.0)
    sender.send(standing())
    sender.dissemination.hear(standing(sender=1))
    assert sender.send(standing()).plan is None
    assert sender.send(standing(plan=new)).plan == new, "robot 1 names another one, and it is new"
    sender.dissemination.hear(standing(sender=1, plan=new))
    assert sender.send(standing(plan=new)).plan is None
    sender.dissemination.hear(standing(sender=1))
    assert sender.send(standing(plan=new)).plan == new
    assert sender.send(standing(plan=new)).plan == new, "until it names the same: messages may be lost"


def test_new_plan_is_spelled_out_even_if_neighbours_follow_it() -> None:
    sender, new = Sender(), plan_of(MISSION, 1.0)
    sender.send(standing())
    sender.dissemination.hear(standing(sender=1, plan=new))
    assert sender.send(standing(plan=new)).plan == new


def test_mission_is_spelled_out_only_for_outdated_neighbours() -> None:
    old, new = MISSION, MISSION.change(shape="line", since=3)
    sender = Sender(new)
    ahead = standing(new, counter=1)
    assert sender.send(ahead).mission_text is None, "no neighbour is known to need it"
    sender.dissemination.hear(standing(old, sender=1))
    text = sender.send(ahead).mission_text
    assert text is not None and old.change(**json.loads(text)) == new
    sender.dissemination.hear(standing(new, sender=1, counter=1))
    assert sender.send(ahead).mission_text is None
    sender.dissemination.hear(standing(old, sender=2, counter=2))
    assert sender.send(ahead).mission_text is None, "robot 2 is ahead"


def test_a_spelled_out_mission_leaves_out_a_robots_own_limits() -> None:
    assert set(json.loads(mission_text(MISSION))) == MISSION_FIELDS - OPTIONAL.keys()
    own = {"n_robots", "safe_distance", "downwash", "max_step", "comm_range", "sense_range", "arena", "obstacles"}
    assert set(Mission.model_fields) - MISSION_FIELDS == own


@pytest.mark.parametrize(("mission", "whole"), [(MISSION, True), (LARGE, False)])
def test_small_differing_tables_are_sent_whole_large_ones_once(mission: Mission, whole: bool) -> None:
    sender = Sender(mission)
    table = table_of(mission, s0=(0, -1.0, 1), s2=(0, -2.0, 0))
    sender.send(standing(mission, table=table, slot=2))
    for _ in range(3):  # changed slots are sent twice
        sender.send(standing(mission, table=table, slot=2))
    sender.dissemination.hear(standing(mission, sender=1))
    assert slots_of(sender.send(standing(mission, table=table, slot=2))) == {0, 2}
    again = slots_of(sender.send(standing(mission, table=table, slot=2)))
    assert again == ({0, 2} if whole else {2}), "a large one once a round"
    sender.begin()
    assert slots_of(sender.send(standing(mission, table=table, slot=2))) == {0, 2}
    sender.begin()
    sender.send(standing(mission, table=table, slot=2))
    other = standing(mission, sender=1, plan=plan_of(mission, 1.0))
    sender.dissemination.hear(other)
    assert slots_of(sender.send(standing(mission, table=table, slot=2))) == {2}, "tables of other plans do not count"


def test_a_change_in_a_large_table_is_sent_in_two_broadcasts() -> None:
    sender = Sender(LARGE)
    entries: dict[str, BidEntry] = {"s0": (0, -1.0, 1)}
    sender.send(standing(LARGE, table=table_of(LARGE, **entries)))
    said: list[set[int]] = []
    for slot in (5, 7, None, None):
        if slot is not None:
            entries[f"s{slot}"] = (1, -3.0, 2)
        said.append(slots_of(sender.send(standing(LARGE, table=table_of(LARGE, **entries)))))
    assert said == [{5}, {5, 7}, {7}, set()]


def test_restless_large_table_is_sent_whole_every_fourth_round() -> None:
    sender, entries, full = Sender(LARGE), {"s0": (0, -1.0, 1)}, list[int]()
    for number in range(2 * RESTLESS_ROUNDS + 1):
        sender.begin()
        for comm_round in range(2):
            sender.dissemination.hear(standing(LARGE, sender=1))
            entries["s5"] = (2 * number + comm_round, -1.0, 2)
            if 0 in slots_of(sender.send(standing(LARGE, table=table_of(LARGE, **entries)))):
                full.append(2 * number + comm_round)
    assert full == [0, 2 * RESTLESS_ROUNDS, 4 * RESTLESS_ROUNDS]


def test_a_robot_without_plan_and_table_sends_neither() -> None:
    sender = Sender()
    bare = Message(sender=0, sequence=0, degree=1, stamp=MissionStamp(0, MISSION.digest))
    said = sender.send(bare)
    assert said.plan is said.table is said.plan_digest is said.table_digest is None and said.places == 0


def test_sequence_numbers_count_distinct_payloads() -> None:
    sender = Sender()
    first, second, third = (sender.send(standing()) for _ in range(3))
    assert (first.sequence, second.sequence, third.sequence) == (0, 1, 1) and second == third


def test_a_team_of_ten_that_agrees_sends_a_few_dozen_bytes() -> None:
    mission = Mission(shape="circle", n_robots=10, arena=WIDE)
    rng = np.random.default_rng(4)
    team = StillTeam(mission, connected_places(10, rng), rng, time_out=1000)
    sizes: list[list[int]] = []
    broadcast = team.transport.broadcast

    def spy(payload: bytes, receivers: tuple[int, ...], sender: int = 0) -> None:
        sizes.append([team.number, len(payload)])
        broadcast(payload, receivers, sender)

    team.transport.broadcast = spy
    team.rounds(14)
    said = [size for number, size in sizes if number == 14]
    comm_rounds = [said[k : k + 10] for k in range(0, len(said), 10)]
    assert len(comm_rounds) == 5
    assert max(comm_rounds[0]) > 250, "the greeting"
    assert max(map(max, comm_rounds[1:])) < 90, max(map(max, comm_rounds[1:]))
