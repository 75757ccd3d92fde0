"""Receiving: the newest message of a sender counts, repeated payloads are applied once a round, memory is bounded."""

from __future__ import annotations

import pytest
from driven_agent import LINE, PLAN, DrivenAgent, make, says
from msgspec.structs import replace
from opened_payloads import Opened

from llm_flock.errors import InputError
from llm_flock.events import MissionGiven, Note, Received
from llm_flock.message import Course, decode, encode
from llm_flock.mission import Mission, mission_text
from llm_flock.plan import Drawing, Plan
from llm_flock.plan import _drawn as draw
from llm_flock.protocol._agreement.messaging import COURSE_ROUNDS, MAX_CHECKED_PLANS, MAX_DRAWN, MAX_REPEATED
from llm_flock.protocol._messages import channel

TEXT = LINE.change(shape="text:a row")


def test_the_newest_message_of_each_sender_is_handed_over_once() -> None:
    driven = DrivenAgent(make())
    driven.begin()
    for sender, sequence in ((2, 5), (1, 0), (2, 4)):
        driven.agent.handle(Received(says(sender, plan=PLAN, sequence=sequence)))
    messaging = driven.agent._messaging
    assert [(each.sender, each.sequence) for each in messaging.drain()] == [(1, 0), (2, 5)]
    assert messaging.drain() == []


def test_another_mission_drops_messages_and_keeps_heartbeats() -> None:
    driven = DrivenAgent(make())
    driven.begin()
    driven.agent.handle(Received(says(1, plan=PLAN, beats=(0, 7, 3))))
    driven.agent.handle(MissionGiven(mission=LINE.change(center=(60.0, 50.0), since=2), ordered_at=1))
    assert driven.agent._messaging.drain() == []
    assert driven.agent._membership.beats[1:] == (7, 3)


def test_requested_way_is_forgotten_two_rounds_after_silence() -> None:
    driven = DrivenAgent(make())
    driven.begin()
    asked = Course(level=1, of=1, path=((60.0, 50.0),))
    said = decode(says(1, plan=PLAN), LINE.n_robots, LINE.dim)
    driven.agent.handle(Received(encode(replace(said, course=asked))))
    messaging = driven.agent._messaging
    messaging.drain()
    for _ in range(COURSE_ROUNDS):
        messaging.begin_round()
        assert messaging.courses == {1: asked}
    messaging.begin_round()
    assert messaging.courses == {}


def test_payload_repeated_in_a_round_is_opened_only_once() -> None:
    driven = DrivenAgent(make())
    opened = Opened(driven.agent)
    driven.begin()
    same = says(1, plan=PLAN)
    assert [opened.during(lambda: driven.comm_round(same, same)) for _ in range(3)] == [1, 0, 0]
    heard: list[int] = []
    driven.agent.handle(Received(same))
    heard.extend(each.sender for each in driven.agent._messaging.drain())
    assert heard == [1]
    driven.end()
    driven.begin()
    assert opened.during(lambda: driven.comm_round(same)) == 1, "in another round it is opened again"


def test_a_payload_that_has_more_to_apply_is_applied_each_time() -> None:
    large = Mission(shape="line", n_robots=21, spacing=4, comm_range=60)
    plan = Plan.of(large.ideal or ())
    driven = DrivenAgent(make(mission=large), here=plan.points[0], plan=plan)
    opened = Opened(driven.agent)
    driven.begin()
    beats = tuple(range(21))
    for payload in (
        says(1, mission=large, plan=plan, beats=beats),
        says(2, mission=large, plan=plan, positions={2: (0, (1.0, 2.0), ())}),
        says(3, mission=large),
        b"noise",
    ):
        assert [opened.during(lambda p=payload: driven.comm_round(p)) for _ in range(3)] == [1, 1, 1]
    assert driven.agent.rejected == {"version": 3}


@pytest.mark.parametrize("by_radio", [True, False])
def test_another_mission_makes_a_repeated_payload_new(by_radio: bool) -> None:
    new = LINE.change(center=(60.0, 50.0), since=2)
    driven = DrivenAgent(make())
    opened = Opened(driven.agent)
    driven.begin()
    same = says(1, plan=PLAN)
    driven.comm_round(same)
    if by_radio:
        driven.comm_round(says(2, mission=new, counter=1, text=mission_text(new)))
    else:
        driven.agent.handle(MissionGiven(mission=new, ordered_at=1))
    assert driven.agent.mission == new
    assert opened.during(lambda: driven.comm_round(same)) == 1
    assert driven.agent.plan is None, "its plan belongs to the mission before"


def test_a_flood_of_payloads_costs_bounded_memory() -> None:
    driven = DrivenAgent(make())
    opened = Opened(driven.agent)
    driven.begin()
    flood = [says(1, plan=PLAN, sequence=k) for k in range(2 * MAX_REPEATED)]
    assert opened.during(lambda: driven.comm_round(*flood)) == len(flood)
    assert opened.during(lambda: driven.comm_round(*flood)) == len(flood) - MAX_REPEATED


def test_refused_plan_is_noted_once_and_a_flood_bounds_memory() -> None:
    refused = make(verify=True)._messaging
    plans = [Plan.of([[float(k), 0.0]]) for k in range(MAX_CHECKED_PLANS + 1)]
    for plan in plans:
        refused.begin_round()
        nothing, (note,) = refused._check_plan(1, plan)
        assert nothing is None and note.kind == "rejected_message" and note.detail["reason"] == "unverified_plan"
    assert refused._check_plan(1, plans[-1]) == (None, [])
    assert refused.rejected == {"unverified_plan": len(plans) + 1}, "counted each time"
    assert refused._check_plan(1, plans[0])[1] != [], "it was forgotten meanwhile"


def program(k: int, places: int = 3, shape: str = "line") -> Plan:
    text = f'{{"draw":[{{"shape":"{shape}","turn":{k}}}],"name":"{k}"}}'
    return Plan(drawing=Drawing(text, places, LINE.spacing, LINE.center))


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Drawing]:
    """The programs that are drawn, in order."""
    seen: list[Drawing] = []
    for cache in (channel._decode, channel._one_plan):
        cache.cache_clear()
    monkeypatch.setattr("llm_flock.plan._drawn", lambda drawing: [seen.append(drawing), draw(drawing)][1])
    return seen


@pytest.mark.parametrize("verify", [True, False])
def test_a_flood_of_programs_is_drawn_up_to_a_share(verify: bool, drawn: list[Drawing]) -> None:
    driven = DrivenAgent(make(mission=TEXT, verify=verify))
    driven.begin()
    flood = [says(1, mission=TEXT, plan=program(k), sequence=k) for k in range(200)]
    driven.comm_round(*flood)
    assert len(drawn) == MAX_DRAWN and driven.agent.rejected == {"many_plans": 200 - MAX_DRAWN}
    driven.comm_round(says(2, mission=TEXT, plan=program(7)), says(2, mission=TEXT, plan=program(500)))
    assert len(drawn) == MAX_DRAWN + 1, "another sender has a share of its own, and a known program costs nothing"
    driven.comm_round(*flood[:MAX_DRAWN])
    assert len(drawn) == MAX_DRAWN + 1
    driven.end()
    driven.begin()
    driven.comm_round(*flood)
    assert len(drawn) == 2 * MAX_DRAWN + 1


def test_programs_of_another_mission_or_size_are_not_drawn(drawn: list[Drawing]) -> None:
    driven = DrivenAgent(make(mission=TEXT, verify=True))
    driven.begin()
    driven.comm_round(says(1, mission=TEXT, plan=program(1, places=2)), says(2, plan=program(2)))
    assert drawn == [] and driven.agent.rejected == {"unverified_plan": 1}


@pytest.mark.parametrize("verify", [True, False])
@pytest.mark.parametrize("shape", ["cube", "blob"])
def test_a_program_that_cannot_be_drawn_is_refused(verify: bool, shape: str) -> None:
    driven = DrivenAgent(make(mission=TEXT, verify=verify))
    driven.begin()
    (note, *_) = driven.comm_round(says(1, mission=TEXT, plan=program(1, shape=shape)))
    assert isinstance(note, Note) and "a plan that cannot be drawn" in str(note.detail["detail"])


@pytest.mark.parametrize(("spacing", "places"), [(1e-9, 3), (9e5, 300)])
def test_a_drawing_whose_places_no_message_holds_is_refused(spacing: float, places: int) -> None:
    plan = Plan(drawing=Drawing('{"draw":[{"shape":"line"}]}', places, spacing, LINE.center))
    with pytest.raises(InputError, match="places"):
        _ = plan.points
