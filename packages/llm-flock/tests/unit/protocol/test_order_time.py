"""The operator's clock, and what a robot does with an order that is not the last one."""

from __future__ import annotations

import pytest
from driven_agent import LINE, DrivenAgent, make

from llm_flock.errors import MessageError
from llm_flock.events import MissionGiven, Note
from llm_flock.message import (
    LATEST,
    MAX_AHEAD_MS,
    Message,
    MissionStamp,
    OperatorClock,
    decode,
    encode,
    order_time,
    time_text,
)

NOW = 1_700_000_000_000


def test_orders_get_later_even_if_the_clock_goes_back() -> None:
    walls = iter([NOW, NOW, NOW + 5, NOW - 10_000, NOW + 6])
    clock = OperatorClock(lambda: next(walls))
    times = [clock.next() for _ in range(5)]
    assert times == sorted(set(times))
    assert times[0] == order_time(NOW) and times[2] == order_time(NOW + 5) and times[4] == order_time(NOW + 6)


def test_restarted_operator_goes_on_from_what_it_hears() -> None:
    before = order_time(NOW + 60_000, 3)
    clock = OperatorClock(lambda: NOW)
    clock.witness(before)
    clock.witness(order_time(NOW - 5))
    assert clock.next() == before + 1


def test_a_clock_that_was_years_ahead_does_not_end_all_orders() -> None:
    years_ahead = order_time(NOW + 3650 * MAX_AHEAD_MS)
    clock = OperatorClock(lambda: NOW)
    clock.witness(years_ahead, own=True)
    assert clock.next() == years_ahead + 1


def test_no_lie_about_the_time_sets_the_clock() -> None:
    clock = OperatorClock(lambda: NOW)
    clock.witness(order_time(NOW + MAX_AHEAD_MS + 1))
    clock.witness(2**59)
    assert clock.next() == order_time(NOW)


def test_an_older_order_is_refused_with_both_times() -> None:
    driven = DrivenAgent(make())
    driven.begin()
    new, old = order_time(NOW, 2), order_time(NOW - 1000)
    driven.agent.handle(MissionGiven(mission=LINE.change(spacing=11), ordered_at=new))
    (note,) = driven.agent.handle(MissionGiven(mission=LINE.change(spacing=12), ordered_at=old))
    assert isinstance(note, Note) and note.kind == "rejected_message" and note.detail["reason"] == "old_mission"
    assert note.detail["detail"] == (
        "an order of 2023-11-14 22:13:20.000 UTC (2) is in force, this one is of 2023-11-14 22:13:19.000 UTC"
    )
    assert driven.agent.ordered_at == new and driven.agent.mission.spacing == 11


def test_times_of_orders_fit_the_wire_and_nothing_above_does() -> None:
    message = Message(sender=1, sequence=0, degree=0, stamp=MissionStamp(LATEST - 1, "0" * 16))
    assert decode(encode(message), 3, 2).mission.counter == LATEST - 1
    beyond = Message(sender=1, sequence=0, degree=0, stamp=MissionStamp(LATEST, "0" * 16))
    with pytest.raises(MessageError, match="malformed"):
        decode(encode(beyond), 3, 2)
    assert time_text(LATEST - 1).startswith("2527")
