"""Beats: at fixed moments, once each, and none is made up for."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

import pytest

from llm_flock_swarm._network.process import PeriodClock, phase_s


@dataclass
class Clock:
    """An event loop's clock. Every sleep moves it, by a little less than asked for if `early` is set."""

    now: float = 100.0
    early: float = 0.0

    def time(self) -> float:
        return self.now

    async def sleep(self, seconds: float) -> None:
        assert seconds >= 0.0
        self.now += seconds - self.early


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(asyncio, "get_running_loop", lambda: clock)
    monkeypatch.setattr(asyncio, "sleep", clock.sleep)
    return clock


def after_next(beat: PeriodClock, clock: Clock) -> float:
    with pytest.raises(StopIteration):
        beat.next().send(None)
    return clock.now


def test_beats_come_at_their_phase(clock: Clock) -> None:
    beat = PeriodClock(0.5, 0.2)
    assert after_next(beat, clock) == pytest.approx(100.2)
    clock.now += 0.3
    assert after_next(beat, clock) == pytest.approx(100.7)


def test_late_robot_waits_for_the_next_beat(clock: Clock) -> None:
    beat = PeriodClock(0.5, 0.2)
    after_next(beat, clock)
    clock.now += 1.2
    assert after_next(beat, clock) == pytest.approx(101.7)


def test_a_timer_that_is_early_does_not_beat_twice(clock: Clock) -> None:
    beat = PeriodClock(0.5, 0.2)
    clock.early = 1e-6
    assert after_next(beat, clock) == pytest.approx(100.2)
    assert after_next(beat, clock) == pytest.approx(100.7)


def test_phases_are_spread_over_a_period() -> None:
    phases = [phase_s(robot, 10, 0.1) for robot in range(10)]
    assert phases == pytest.approx([0.01 * robot for robot in range(10)])
