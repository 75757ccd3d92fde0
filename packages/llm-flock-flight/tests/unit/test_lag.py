"""How late a team is, and how far each drone is from where it should be then."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from flights import flight_config
from hypothesis import given, settings
from hypothesis import strategies as st

from llm_flock.record._schema import NullWriter
from llm_flock.robots._base import Equipment, Position, RobotState
from llm_flock.robots._segment import Segment
from llm_flock_flight._cascade import STEP_S, Cascade
from llm_flock_flight._flight.lag import LagTracker, distance_m, lag_bound_s
from llm_flock_flight._flight.log import FlightLog
from llm_flock_flight._flight.setpoints import resting

PID = Equipment(controller="PID", lag_s=0.5)
ENDS: list[tuple[Position, Position]] = [
    ((-1.0, -1.0, 1.0), (-0.5, -1.0, 1.0)),
    ((1.0, -1.0, 1.0), (1.0, -0.8, 1.0)),
    ((1.0, 1.0, 1.0), (1.0, 1.0, 1.0)),
    ((-1.0, 1.0, 1.0), (-0.7, 0.6, 1.0)),
]
MOTIONS = [Segment(start=start, target=target, duration_s=3.0, began_s=10.0) for start, target in ENDS]


def states_at(places: list[Position], now: float) -> list[RobotState]:
    return [RobotState(position=place, stamp_s=now, equipment=PID) for place in places]


@pytest.mark.parametrize("delay_s", [0.0, 0.13, 0.5, 0.9])
def test_a_delay_that_all_share_is_found_and_costs_nothing(delay_s: float) -> None:
    tracker = LagTracker(flight_config())
    for now in np.arange(10.5, 14.0, 0.1):
        places = [motion.at(now - delay_s)[0] for motion in MOTIONS]
        found = tracker.look(states_at(places, float(now)), MOTIONS, range(4))
        assert max(found.off_m) < 0.004
        if 11.0 < now < 12.5:
            assert all(delay == pytest.approx(delay_s, abs=0.01) for delay in found.delay_s)


def test_drones_with_the_stock_controller_are_in_step() -> None:
    """Each is up to 20 cm behind its set-point, and within a centimetre of where that was, at one time for all."""
    tracker = LagTracker(flight_config())
    bodies = [Cascade(place=start, now=10.0) for start, _ in ENDS]
    furthest = worst = 0.0
    while bodies[0].now < 15.0:
        now = bodies[0].now + STEP_S
        set_points = [motion.at(now)[0] for motion in MOTIONS]
        for body, set_point in zip(bodies, set_points, strict=True):
            body.step(set_point, 0.0)
        found = tracker.look(states_at([body.place for body in bodies], now), MOTIONS, range(4))
        furthest = max(furthest, *(math.dist(body.place, at) for body, at in zip(bodies, set_points, strict=True)))
        worst = max(worst, *found.off_m)
    assert furthest > 0.15 and worst < 0.01


def test_the_one_that_does_not_move_is_the_one_that_is_off() -> None:
    tracker = LagTracker(flight_config())
    now = 11.7
    places = [motion.at(now - 0.5)[0] for motion in MOTIONS]
    places[0] = MOTIONS[0].start
    found = tracker.look(states_at(places, now), MOTIONS, range(4))
    assert found.off_m[0] > 0.1 and max(found.off_m[1:]) < 0.01


@settings(deadline=None)
@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.5, 2.5))
def test_lag_covers_the_difference_between_two_delays(one_s: float, two_s: float, after_s: float) -> None:
    """No delay suits both: what their distances lose against the set-points' is never more than what is reported."""
    motions = [
        Segment(start=(0.0, 0.0, 1.0), target=(0.5, 0.0, 1.0), duration_s=3.0),
        Segment(start=(0.8, 0.0, 1.0), target=(1.3, 0.0, 1.0), duration_s=3.0),
    ]
    places = [motion.at(after_s - lag)[0] for motion, lag in zip(motions, (one_s, two_s), strict=True)]
    found = LagTracker(flight_config(2, "line")).look(states_at(places, after_s), motions, range(2))
    lost = 0.8 - math.dist(*places)
    assert lost <= sum(found.off_m) + 1e-9


@settings(deadline=None)
@given(
    st.lists(st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)), min_size=4, max_size=4),
    st.lists(st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)), min_size=4, max_size=4),
    st.floats(0.0, 1.0),
    st.floats(0.0, 5.0),
)
def test_drones_in_step_keep_apart_but_for_the_reported_error(
    steps: list[tuple[float, float]], errors: list[tuple[float, float]], delay_s: float, after_s: float
) -> None:
    motions = [
        replace(motion, target=(x + dx, y + dy, z), began_s=0.0)
        for motion, (dx, dy) in zip(MOTIONS, steps, strict=True)
        for x, y, z in [motion.start]
    ]
    places = [
        (x + ex, y + ey, z)
        for motion, (ex, ey) in zip(motions, errors, strict=True)
        for x, y, z in [motion.at(after_s - delay_s)[0]]
    ]
    found = LagTracker(flight_config()).look(states_at(places, after_s), motions, range(4))
    for a, b in itertools.combinations(range(4), 2):
        then = min(
            math.dist(motions[a].at(t)[0], motions[b].at(t)[0]) for t in np.linspace(after_s - 2.0, after_s, 201)
        )
        assert math.dist(places[a], places[b]) >= then - found.off_m[a] - found.off_m[b] - 1e-3


def test_drones_begun_at_different_times_have_their_own_delays() -> None:
    motions = [MOTIONS[0], replace(MOTIONS[1], began_s=10.5), resting((0.0, 0.0, 1.0))]
    now = 11.8
    places = [motions[0].at(now - 0.2)[0], motions[1].at(now - 0.8)[0], (0.03, 0.0, 1.0)]
    found = LagTracker(flight_config(3, "line")).look(states_at(places, now), motions, range(3))
    assert found.delay_s == (pytest.approx(0.2, abs=0.02), pytest.approx(0.8, abs=0.03), 0.0)
    assert found.off_m[2] == pytest.approx(0.03)


def test_heights_count_less_if_no_drone_flies_above_another() -> None:
    config = flight_config()
    assert config.height_tracking_m == 0.15
    assert distance_m(config, (0.0, 0.0, 1.0), (0.03, 0.0, 1.09)) == pytest.approx(math.hypot(0.03, 0.03))


def test_how_late_a_team_may_be() -> None:
    assert lag_bound_s(flight_config(), [Equipment(), PID]) == pytest.approx(1.0)
    assert lag_bound_s(flight_config(), [Equipment()]) == pytest.approx(0.25)
    assert lag_bound_s(flight_config(lag_s=0.1), [PID]) == 0.1


def test_reported_lag_is_that_of_moving_set_points() -> None:
    """Estimates shake by 3 mm, so a delay that is fitted where set-points nearly rest may be any."""
    config, rng = flight_config(), np.random.default_rng(5)
    log, tracker = FlightLog(config, NullWriter()), LagTracker(config)
    fitted: list[float] = []
    for number, delay_s in ((0, 0.95), (1, 0.55), (2, 0.5)):  # the first is a take-off
        log.round = number
        motions = [replace(motion, began_s=10.0 * number) for motion in MOTIONS]
        for now in np.arange(10.0 * number, 10.0 * number + 4.5, 0.05):
            places = [tuple(np.array(motion.at(now - delay_s)[0]) + rng.normal(0.0, 0.003, 3)) for motion in motions]
            states = states_at(places, float(now))
            found = tracker.look(states, motions, range(4))
            log.look(float(now), states, motions, frozenset(range(4)), frozenset(range(4)), found)
            fitted.append(max(found.delay_s) if number else 0.0)
    assert max(fitted) > 0.9, "some moment's fit is at its bound"
    assert log.lag_s == pytest.approx(0.55, abs=0.02)
