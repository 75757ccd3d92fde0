"""Limits, segments, the point mass and the simulated robot."""

from __future__ import annotations

import asyncio
import itertools
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from llm_flock.errors import InputError
from llm_flock.robots._base import PEAK_SPEED, MotionLimits, RobotError
from llm_flock.robots._point_mass import PointMass
from llm_flock.robots._segment import Segment, stopping_point
from llm_flock.robots._simulated_robot import SimulatedRobot
from llm_flock.testing import check_emergency_stop, check_robot

pytestmark = pytest.mark.usefixtures("skipped_waits")

COORDINATE = st.floats(-3.0, 3.0).map(lambda x: round(x, 3))
POINT = st.tuples(COORDINATE, COORDINATE, COORDINATE)
BOX = MotionLimits(low=(-2.0, -2.0, 0.0), high=(2.0, 2.0, 2.0), max_speed_m_s=1.0)


def norm(a, b=(0.0, 0.0, 0.0)):
    return float(np.linalg.norm(np.subtract(a, b)))


@given(start=POINT.filter(BOX.contains), target=POINT, duration=st.floats(0.1, 5.0))
def test_clipped_target_is_on_the_line_in_the_box_and_slow(start, target, duration):
    sent = BOX.clip(start, target, duration)
    assert sent.duration_s == duration
    assert BOX.contains(sent.target)
    assert norm(start, sent.target) + norm(sent.target, target) == pytest.approx(norm(start, target), abs=1e-6)
    assert PEAK_SPEED * norm(start, sent.target) / duration <= BOX.max_speed_m_s * (1 + 1e-9)
    if BOX.contains(target) and PEAK_SPEED * norm(start, target) / duration < BOX.max_speed_m_s * (1 - 1e-9):
        assert sent.target == target


def test_from_outside_the_box_a_robot_comes_back_in():
    sent = BOX.clip((2.5, 0.0, 1.0), (5.0, 1.0, 1.0), 10.0)
    assert sent.target == (2.0, 1.0, 1.0)


def test_limits_refuse_what_makes_no_sense():
    with pytest.raises(InputError):
        MotionLimits(low=(1.0, 0.0, 0.0), high=(0.0, 1.0, 1.0))
    with pytest.raises(InputError):
        MotionLimits(max_speed_m_s=0.0)
    with pytest.raises(InputError):
        BOX.clip((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.0)


@given(POINT, POINT, POINT, POINT, st.floats(0.5, 4.0))
def test_a_segment_keeps_its_ends_and_comes_to_rest(start, target, velocity, acceleration, duration):
    segment = Segment(start=start, target=target, duration_s=duration, velocity=velocity, acceleration=acceleration)
    at, v, a = segment.at(0.0)
    assert np.allclose(at, start) and np.allclose(v, velocity) and np.allclose(a, acceleration, atol=1e-9)
    at, v, a = segment.at(duration * (1 - 1e-9))
    assert np.allclose(at, target, atol=1e-5) and np.allclose(v, 0, atol=1e-4) and np.allclose(a, 0, atol=1e-3)
    assert segment.at(duration + 1.0) == (target, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    # Derivatives are the derivatives.
    t, h = 0.4 * duration, 1e-5 * duration
    before, _, _ = segment.at(t - h)
    after, _, _ = segment.at(t + h)
    _, v, _ = segment.at(t)
    assert np.allclose(np.subtract(after, before) / (2 * h), v, atol=1e-4)


def test_peak_speed_of_a_segment_is_the_one_limits_assume():
    segment = Segment(start=(0.0, 0.0, 0.0), target=(1.0, 0.0, 0.0), duration_s=2.0)
    speeds = [segment.at(t)[1][0] for t in np.linspace(0, 2, 2001)]
    assert max(speeds) == pytest.approx(PEAK_SPEED / 2.0, abs=1e-9)


@given(st.lists(st.tuples(POINT, POINT), min_size=2, max_size=4), st.floats(0.1, 1.9))
def test_robots_started_together_have_flown_the_same_share(ways, time):
    shares = []
    for start, target in ways:
        at, _, _ = Segment(start=start, target=target, duration_s=2.0).at(time)
        if norm(start, target) > 0.01:
            shares.append(norm(start, at) / norm(start, target))
    assert all(a == pytest.approx(b, abs=1e-6) for a, b in itertools.pairwise(shares))


def test_stopping_point_is_on_the_way_without_turning_back():
    segment = Segment(start=(0.0, 0.0, 1.0), target=(2.0, 0.0, 1.0), duration_s=4.0)
    for t in np.linspace(0.0, 2.5, 26):
        stop = stopping_point(segment, float(t), 1.0)
        assert stop is not None
        at, velocity, acceleration = segment.at(float(t))
        braking = Segment(start=at, target=stop, duration_s=1.0, velocity=velocity, acceleration=acceleration)
        way = [braking.at(s)[0][0] for s in np.linspace(0, 1, 200)]
        assert max(way) <= 2.0
        assert max(way) - way[-1] < 0.02
    assert stopping_point(segment, 3.5, 1.0) is None


def test_a_point_mass_flies_lands_and_stands():
    body = PointMass(home=(1.0, 2.0, 0.0))
    assert body.take_off(0.5, 1.0, now=0.0) != 0  # not armed
    assert body.arm(True)
    assert body.take_off(0.5, 1.0, now=0.0) == 0
    assert body.take_off(0.5, 1.0, now=0.5) != 0  # flies already
    assert body.position(1.0) == pytest.approx((1.0, 2.0, 0.5))
    assert body.go_to((1.5, 2.0, 0.5), 1.0, now=2.0) == 0
    assert body.position(2.5)[0] == pytest.approx(1.25)
    assert body.land(0.02, 1.0, now=4.0) == 0
    assert body.land(0.02, 1.0, now=4.5) != 0
    assert body.position(5.1) == (1.5, 2.0, 0.0)
    assert not body.flying and body.position(100.0) == (1.5, 2.0, 0.0)


def test_a_point_mass_falls_when_its_motors_stop():
    body = PointMass(home=(0.0, 0.0, 0.0), auto_arm=True)
    body.take_off(1.0, 1.0, now=0.0)
    body.emergency_stop(2.0)
    assert not body.flying and not body.armed and body.locked
    assert body.position(2.1)[2] == pytest.approx(1.0 - 9.81 * 0.01 / 2)
    assert body.position(3.0)[2] == 0.0
    assert not body.arm(True) and body.take_off(1.0, 1.0, now=4.0) != 0
    landed_too_high = PointMass(home=(0.0, 0.0, 0.0), auto_arm=True)
    landed_too_high.take_off(1.0, 1.0, now=0.0)
    landed_too_high.land(0.5, 1.0, now=2.0)
    assert 0.0 < landed_too_high.position(3.2)[2] < 0.5
    assert landed_too_high.position(5.0)[2] == 0.0


def test_body_follows_its_wrong_belief_after_an_estimate_jump():
    body = PointMass(home=(0.0, 0.0, 0.0), auto_arm=True)
    body.take_off(1.0, 1.0, now=0.0)
    body.jump((0.3, 0.0, 0.0), now=2.0)
    assert body.position(2.0) == pytest.approx((0.0, 0.0, 1.0))
    assert body.estimate(2.0) == pytest.approx((0.3, 0.0, 1.0))
    assert body.position(6.0) == pytest.approx((-0.3, 0.0, 1.0), abs=1e-4)
    assert body.estimate(6.0) == pytest.approx((0.0, 0.0, 1.0), abs=1e-4)


def test_a_stalled_estimate_stands_still_and_is_not_settled():
    body = PointMass(home=(0.0, 0.0, 0.0), auto_arm=True)
    body.take_off(1.0, 1.0, now=0.0)
    body.stall(0.5)
    assert body.estimate(3.0) == body.estimate(0.5) and body.variance(3.0) > 0.05
    assert body.position(3.0)[2] == pytest.approx(1.0)
    body.stall(3.0, stalled=False)
    assert body.estimate(3.0)[2] == pytest.approx(1.0) and body.variance(3.0) < 0.001


def test_the_simulated_robot_keeps_the_contract():
    asyncio.run(check_robot(SimulatedRobot("one", (0.0, 0.0, 0.0)), patience_s=1.0))


def test_the_simulated_robot_stops_when_told():
    asyncio.run(check_emergency_stop(SimulatedRobot("one", (0.0, 0.0, 0.0))))


class Hovering(SimulatedRobot):
    """Believes itself in the air once it has landed."""

    async def land(self, height_m: float, duration_s: float) -> None:
        await super().land(height_m, duration_s)
        self.body.jump((0.0, 0.0, 0.3), time.monotonic())


@pytest.mark.clock(4)
def test_a_landing_above_the_ground_is_told_in_heights():
    with pytest.raises(AssertionError, match=r"a landed robot is on the ground: at 0 m, not 0\.\d+ m"):
        asyncio.run(check_robot(Hovering("one", (0.0, 0.0, 0.0))))


def test_a_simulated_robot_loses_its_link():
    async def flight() -> None:
        robot = SimulatedRobot("one", (0.0, 0.0, 0.0))
        await robot.connect(1.0)
        robot.lose_link()
        assert robot.state().link_lost and not await robot.stop_motors()
        with pytest.raises(RobotError, match="link is lost"):
            await robot.arm()
        with pytest.raises(RobotError, match="no answer within"):
            await robot.connect(0.01)

    asyncio.run(flight())


class Careless(SimulatedRobot):
    """Clips a target aside instead of along its line."""

    async def go_to(self, target, duration_s):
        x, y, z = target
        return await super().go_to((min(x, 2.0), y if x <= 2.0 else -1.0, z), duration_s)


def test_the_contract_notices_a_target_moved_aside():
    with pytest.raises(AssertionError, match="along the segment"):
        asyncio.run(check_robot(Careless("one", (0.0, 0.0, 0.0)), patience_s=0.5))
