"""Flights in which somebody answers late, not any more, or with an error: a drone, its driver, a listener."""

from __future__ import annotations

import asyncio
import time
from dataclasses import replace

import pytest
from flights import Robots, figures, flight_config, flown

from llm_flock_flight._flight.flight import Flight
from llm_flock_flight._flight.landing import STOPPED

pytestmark = pytest.mark.usefixtures("skipped_waits")


@pytest.mark.parametrize("at", ["taking off", "flying", "landing"])
def test_a_listener_that_fails_ends_the_flight_and_all_land(at: str) -> None:
    made: Robots = []

    def fail(flight: Flight, robots: Robots) -> None:
        made.extend(robots)
        raise RuntimeError("a display")

    with pytest.raises(RuntimeError, match="a display"):
        flown(flight_config(), fail, at)
    assert [robot.body.position(time.monotonic())[2] for robot in made[:4]] == [0.0] * 4
    assert not any(robot.state().flying for robot in made)


def test_drone_heard_again_lands_and_is_not_locked() -> None:
    """This computer stood still, and the driver gave the link up; but orders reach the drone, and news come from it."""

    def give_up(flight: Flight, robots: Robots) -> None:
        plain = robots[1].state
        robots[1].state = lambda: replace(plain(), link_lost=True)

    flight = figures(flown(flight_config(), give_up))
    assert flight.ended == "link_lost" and set(flight.ends.values()) == {"landed"} and flight.safe


@pytest.mark.parametrize("late_s", [1.1, 3.0])
def test_drone_slow_to_take_the_order_to_land_is_landed(late_s: float) -> None:
    def slow(flight: Flight, robots: Robots) -> None:
        plain = robots[1].land

        async def land(height_m: float, duration_s: float) -> None:
            await asyncio.sleep(late_s)
            await plain(height_m, duration_s)

        robots[1].land = land

    flight = figures(flown(flight_config(), slow))
    assert flight.ended == "mission" and set(flight.ends.values()) == {"landed"}


@pytest.mark.parametrize(
    ("command", "at", "says"),
    [
        ("arm", "taking off", "d1: did not arm within 6 s"),
        ("take_off", "taking off", "d1: did not take off within 6 s"),
        ("go_to", "round 1", "d1: did not take its next set-point within 1 s"),
    ],
)
def test_a_driver_that_does_not_answer_ends_the_flight_by_name(command: str, at: str, says: str) -> None:
    async def never(*_: object) -> None:
        await asyncio.sleep(3600.0)

    def hang(flight: Flight, robots: Robots) -> None:
        setattr(robots[1], command, never)

    flight = figures(flown(flight_config(), hang, at))
    assert (flight.ended, flight.reason) == ("refused", says)
    assert {flight.ends[name] for name in ("d0", "d2", "d3")} <= {"landed", "never took off", STOPPED}
