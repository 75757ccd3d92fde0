"""The point mass: it flies, lands and falls, and its estimate can jump or stall."""

from __future__ import annotations

import pytest

from llm_flock.robots._point_mass import PointMass


def test_a_point_mass_flies_lands_and_stands() -> None:
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


def test_a_point_mass_falls_when_its_motors_stop() -> None:
    body = PointMass(home=(0.0, 0.0, 0.0), auto_arm=True)
    body.take_off(1.0, 1.0, now=0.0)
    body.emergency_stop(2.0)
    assert not body.flying and not body.armed and body.locked
    assert body.position(2.1)[2] == pytest.approx(1.0 - 9.81 * 0.01 / 2)
    assert body.position(3.0)[2] == 0.0
    assert not body.arm(True) and body.take_off(1.0, 1.0, now=4.0) != 0


def test_point_mass_released_above_the_ground_falls() -> None:
    body = PointMass(home=(0.0, 0.0, 0.0), auto_arm=True)
    body.take_off(1.0, 1.0, now=0.0)
    body.land(0.5, 1.0, now=2.0)
    assert 0.0 < body.position(3.2)[2] < 0.5
    assert body.position(5.0)[2] == 0.0


def test_body_follows_its_wrong_belief_after_an_estimate_jump() -> None:
    body = PointMass(home=(0.0, 0.0, 0.0), auto_arm=True)
    body.take_off(1.0, 1.0, now=0.0)
    body.jump((0.3, 0.0, 0.0), now=2.0)
    assert body.position(2.0) == pytest.approx((0.0, 0.0, 1.0))
    assert body.estimate(2.0) == pytest.approx((0.3, 0.0, 1.0))
    assert body.position(6.0) == pytest.approx((-0.3, 0.0, 1.0), abs=1e-4)
    assert body.estimate(6.0) == pytest.approx((0.0, 0.0, 1.0), abs=1e-4)


def test_a_stalled_estimate_stands_still_and_is_not_settled() -> None:
    body = PointMass(home=(0.0, 0.0, 0.0), auto_arm=True)
    body.take_off(1.0, 1.0, now=0.0)
    body.stall(0.5)
    assert body.estimate(3.0) == body.estimate(0.5) and body.variance(3.0) > 0.05
    assert body.position(3.0)[2] == pytest.approx(1.0)
    body.stall(3.0, stalled=False)
    assert body.estimate(3.0)[2] == pytest.approx(1.0) and body.variance(3.0) < 0.001
