"""Poses that no drone can have flown, however small their steps."""

from __future__ import annotations

from llm_flock.robots._base import Pose, PoseFrame
from llm_flock_flight._flight.sections import PositionsConfig
from llm_flock_flight._positions import PoseGate
from llm_flock_flight._positions.gate import JUMP

LIMITS = PositionsConfig(pose_late_s=0.1, pose_lost_s=0.5, pose_jump_m=0.1, pose_frozen_s=0.0)


def fly(speed_m_s: float, rate_hz: float, seconds: float) -> tuple[float, PoseGate]:
    """Poses of a drone along x, and how far the accepted ones go [m]."""
    gate, x = PoseGate(["cf1"], LIMITS, 1.0), 0.0
    gate.flying = True
    for k in range(int(seconds * rate_hz)):
        frame = PoseFrame(stamp_s=k / rate_hz, poses={"cf1": Pose((speed_m_s * k / rate_hz, 0.0, 1.0))})
        accepted = gate.take(frame, 100.0 + k / rate_hz)
        x = accepted["cf1"].position[0] if accepted else x
    return x, gate


def test_small_steps_do_not_add_up_to_a_speed_that_no_drone_has() -> None:
    for rate_hz in (30.0, 100.0, 1000.0):
        x, gate = fly(2.9, rate_hz, 2.0)
        assert x <= LIMITS.pose_jump_m + 0.5
        assert gate.refused["cf1", JUMP] > 0


def test_a_drone_at_its_highest_speed_is_followed() -> None:
    for rate_hz in (30.0, 100.0, 1000.0):
        x, gate = fly(1.0, rate_hz, 5.0)
        assert x > 4.9
        assert not gate.refused
