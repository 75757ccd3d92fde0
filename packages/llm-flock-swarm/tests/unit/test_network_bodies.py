"""Commanded bodies: in time or not at all, never farther than the deadline, and measured all the way."""

from __future__ import annotations

import math

import numpy as np
import pytest

from llm_flock.arrays import Point
from llm_flock.protocol._motion.shield_async import Sighting
from llm_flock_swarm._network.body_control import BodyControl
from llm_flock_swarm._network.config import SwarmConfig, warn_of_spacing
from llm_flock_swarm._network.wire import Body, Command
from llm_flock_swarm._network.world import WorldBodies

SPEED, PERIOD, LAG = 12.0, 0.1, 0.05
CONFIG = {"shape": "circle", "n_robots": 4, "max_step": 6.0, "step_s": 6.0 / SPEED, "control_s": PERIOD, "lag_s": LAG}


def bodies(*start: Point) -> WorldBodies:
    return WorldBodies(np.array(start), speed=SPEED, period_s=PERIOD, lag_s=LAG, now=0.0)


def order(number: int, stamp: float, origin: Point, target: Point) -> Command:
    return Command(number=number, stamp=stamp, origin=origin, target=target)


def test_a_command_is_flown_at_the_speed_and_answered() -> None:
    world = bodies((0.0, 0.0), (50.0, 0.0))
    assert world.command(0, order(1, 0.0, (0.0, 0.0), (1.2, 0.0)), 0.0)
    world.advance(0.05)
    assert world.positions[0] == pytest.approx([0.6, 0.0])
    assert world.states()[0].end == (1.2, 0.0) and world.states()[0].command == 1
    world.advance(0.2)
    assert world.positions[0] == pytest.approx([1.2, 0.0])


def test_the_world_measures_by_the_norm_of_the_mission() -> None:
    start = np.array([(0.0, 0.0, 0.0), (0.0, 0.0, 8.0)])
    world = WorldBodies(start, speed=SPEED, period_s=PERIOD, lag_s=LAG, now=0.0, downwash=2.0)
    assert world.closest() == 4.0
    assert world.command(0, order(1, 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 1.2)), 0.0)
    world.advance(0.2)
    assert world.closest() == pytest.approx(3.4) == world.closest()


def test_bodies_go_on_where_the_clock_is_set_back() -> None:
    world = bodies((0.0, 0.0), (50.0, 0.0))
    world.advance(3600.0)
    assert world.command(0, order(1, 100.0, (0.0, 0.0), (1.2, 0.0)), 100.0)
    world.advance(100.05)
    assert world.positions[0] == pytest.approx([0.6, 0.0])


def test_commands_follow_each_other_on_the_way() -> None:
    world = bodies((0.0, 0.0), (50.0, 0.0))
    world.command(0, order(1, 0.0, (0.0, 0.0), (1.2, 0.0)), 0.02)
    assert world.command(0, order(2, 0.1, (1.2, 0.0), (1.2, 1.2)), 0.1)
    world.advance(0.5)
    assert world.positions[0] == pytest.approx([1.2, 1.2])


@pytest.mark.parametrize(
    ("stamp", "origin", "target", "late"),
    [
        (-0.06, (0.0, 0.0), (1.0, 0.0), 1),
        (0.06, (0.0, 0.0), (1.0, 0.0), 1),
        (0.0, (0.0, 0.0), (math.nan, 0.0), 1),
        (0.0, (0.0, 0.0), (1.0,), 1),
        (0.0, (0.1, 0.0), (1.0, 0.0), 0),
        (0.0, (), (1.0, 0.0), 0),
    ],
)
def test_late_or_displaced_commands_are_not_flown(stamp: float, origin: Point, target: Point, late: int) -> None:
    world = bodies((0.0, 0.0), (50.0, 0.0))
    assert not world.command(0, order(1, stamp, origin, target), 0.0)
    world.advance(1.0)
    assert world.positions[0].tolist() == [0.0, 0.0] and world.late == late and world.states()[0].command == 1


def test_an_old_number_is_not_even_answered() -> None:
    world = bodies((0.0, 0.0), (50.0, 0.0))
    world.command(0, order(3, 0.0, (0.0, 0.0), (1.0, 0.0)), 0.0)
    assert not world.command(0, order(3, 0.0, (1.0, 0.0), (2.0, 0.0)), 0.0)
    assert world.states()[0].end == (1.0, 0.0)


def test_a_body_stops_at_its_deadline_wherever_it_is() -> None:
    world = bodies((0.0, 0.0), (50.0, 0.0))
    world.command(0, order(1, 0.0, (0.0, 0.0), (30.0, 0.0)), 0.0)
    world.advance(5.0)
    assert world.positions[0][0] == pytest.approx(SPEED * (PERIOD + LAG))
    assert world.states()[0].end == tuple(world.positions[0].tolist())


def test_separation_is_measured_on_the_way_not_only_at_frames() -> None:
    world = bodies((0.0, 0.0), (1.2, 0.0))
    world.command(0, order(1, 0.0, (0.0, 0.0), (1.2, 0.0)), 0.0)
    world.command(1, order(1, 0.0, (1.2, 0.0), (0.0, 0.0)), 0.0)
    world.advance(0.2)
    assert world.closest() == pytest.approx(0.0, abs=1e-9)
    assert world.closest() == pytest.approx(1.2)


def pilotage(*, shield_on: bool = True) -> BodyControl:
    own = BodyControl(SwarmConfig.build({}, **CONFIG, shield=shield_on))
    own.update(Body(position=(50.0, 50.0), end=(50.0, 50.0), command=7))
    own.waypoint = (56.0, 50.0)
    return own


def test_a_free_way_is_flown_at_full_speed() -> None:
    command = pilotage().control(0.0, [], 0.0)
    assert command is not None and command.number == 8
    assert command.target == pytest.approx((51.2, 50.0))


def test_the_next_command_waits_for_the_answer_to_the_last() -> None:
    own = pilotage()
    assert own.control(0.0, [], 0.0) is not None
    assert own.control(0.1, [], 0.0) is None
    own.update(Body(position=(50.5, 50.0), end=(51.2, 50.0), command=8))
    second = own.control(0.1, [], 0.0)
    assert second is not None and second.origin == (51.2, 50.0)
    lost = own.control(0.5, [], 0.0)
    assert lost is not None and lost.number == 10


def test_nothing_to_fly_is_no_command() -> None:
    own = pilotage()
    own.waypoint = None
    assert own.control(0.0, [], 0.0) is None and not own.arrived
    own.waypoint = (50.0, 50.0)
    assert own.control(0.0, [], 0.0) is None and own.arrived
    blank = BodyControl(SwarmConfig.build({}, **CONFIG))
    assert blank.control(0.0, [], 0.0) is None and blank.end is None


def test_the_age_of_a_sighting_takes_its_way() -> None:
    fresh = pilotage().control(0.0, [Sighting(position=(56.0, 50.0), age_s=0.0)], 0.0)
    stale = pilotage().control(0.0, [Sighting(position=(56.0, 50.0), age_s=0.3)], 0.0)
    assert fresh is not None and fresh.target[0] == pytest.approx(51.2)
    assert stale is None or stale.target[0] <= 50.0


def test_robot_with_old_observations_stands_still() -> None:
    assert pilotage().control(0.0, [], 1.0) is None
    assert pilotage(shield_on=False).control(0.0, [], 1.0) is not None


def test_spacing_too_tight_for_bodies_not_in_step_is_warned_of(caplog: pytest.LogCaptureFixture) -> None:
    for fields in ({"spacing": 5.31}, {"spacing": 4.0, "shield": False}, {"spacing": 4.0, "step_s": 1.5}):
        warn_of_spacing(SwarmConfig.build({}, **{**CONFIG, **fields}))
    assert not caplog.records
    warn_of_spacing(SwarmConfig.build({}, **CONFIG, spacing=5.2))
    (warning,) = [record.message for record in caplog.records]
    assert warning.startswith("spacing = 5.2 ") and "pass each other at 5.3." in warning
