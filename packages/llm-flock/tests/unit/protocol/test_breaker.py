"""The circuit breaker: when it opens, when it probes, and when it closes."""

from __future__ import annotations

from itertools import pairwise

import pytest

from llm_flock.planner import NoAnswer
from llm_flock.protocol._breaker import FIRST_WAIT, THRESHOLD, BreakerState, CircuitBreaker

FAILURE = NoAnswer(cause="answer", reason="not readable")


def opened() -> CircuitBreaker:
    """A breaker that opened in round 2."""
    breaker = CircuitBreaker("step", enabled=True)
    for number in range(1, THRESHOLD + 1):
        assert breaker.asks(number)
        breaker.refused(number, FAILURE)
    return breaker


def asked_in(breaker: CircuitBreaker, rounds: range) -> list[int]:
    """The rounds in which a model that is always refused is asked."""
    found: list[int] = []
    for number in rounds:
        if breaker.asks(number):
            found.append(number)
            breaker.refused(number, FAILURE)
    return found


def test_breaker_opens_and_is_noted_after_refusals_in_a_row() -> None:
    breaker = CircuitBreaker("plan", enabled=True)
    assert breaker.refused(1, FAILURE) == [] and breaker.asks(2)
    for _ in range(4):
        assert breaker.usable() == [] and breaker.refusals == 0
    assert breaker.refused(3, FAILURE) == [] and not breaker.is_open
    (note,) = breaker.refused(4, FAILURE)
    assert note.kind == "breaker" and note.detail == {
        "question": "plan",
        "state": "open",
        "refusals": 2,
        "wait": FIRST_WAIT,
        "reason": "not readable",
    }
    assert breaker.is_open and breaker.reason == FAILURE and not breaker.asks(5)


@pytest.mark.parametrize("good", [1, 2])
def test_model_bad_at_every_second_question_is_contained(good: int) -> None:
    breaker = CircuitBreaker("step", enabled=True)
    number = 0
    while not breaker.is_open:
        for _ in range(good):
            breaker.usable()
        breaker.refused(number := number + 1, FAILURE)
        assert number < 10
    assert number == 3
    rarely = CircuitBreaker("step", enabled=True)
    for number in range(50):
        for _ in range(4):
            rarely.usable()
        rarely.refused(number, FAILURE)
    assert not rarely.is_open, "a model that is refused once in five questions is still asked"


def test_probes_come_at_growing_intervals_up_to_a_longest_one() -> None:
    rounds = asked_in(CircuitBreaker("step", enabled=True), range(1, 400))
    waits = [later - earlier for earlier, later in pairwise(rounds)]
    assert rounds[:THRESHOLD] == [1, 2]
    assert waits[1:6] == [2, 4, 8, 16, 32] and set(waits[6:]) == {64}


def test_a_probe_is_half_open_until_it_is_answered() -> None:
    breaker = opened()
    assert breaker.asks(4) and breaker.state is BreakerState.HALF_OPEN and breaker.is_open
    assert breaker.asks(5), "a question that was replaced by a newer one is still owed an answer"
    (note,) = breaker.usable()
    assert note.detail["state"] == "closed" and note.detail["wait"] is None and not breaker.is_open


def test_recovered_model_needs_two_answers_for_a_new_chance() -> None:
    breaker = opened()
    breaker.asks(4)
    breaker.usable()
    assert breaker.asks(5) and breaker.refused(5, FAILURE) and not breaker.asks(8) and breaker.asks(9)
    breaker.usable()
    breaker.usable()
    assert breaker.refused(12, FAILURE) == [], "from then on it takes two again"
    (note,) = breaker.refused(13, FAILURE)
    assert note.detail["wait"] == FIRST_WAIT


def test_another_mission_is_probed_at_once() -> None:
    breaker = opened()
    breaker.begin_mission()
    assert breaker.refusals == 0 and breaker.asks(3) and breaker.state is BreakerState.HALF_OPEN


@pytest.mark.parametrize("refusals", [1, 50])
def test_a_disabled_breaker_only_counts(refusals: int) -> None:
    breaker = CircuitBreaker("step", enabled=False)
    assert asked_in(breaker, range(1, refusals + 1)) == list(range(1, refusals + 1))
    assert not breaker.is_open and breaker.refusals == refusals
