"""Limits clip a motion along its line, and reject invalid values."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from llm_flock.errors import InputError
from llm_flock.robots._base import PEAK_SPEED, MotionLimits, Position

COORDINATE = st.floats(-3.0, 3.0).map(lambda x: round(x, 3))
POINT = st.tuples(COORDINATE, COORDINATE, COORDINATE)
BOX = MotionLimits(low=(-2.0, -2.0, 0.0), high=(2.0, 2.0, 2.0), max_speed_m_s=1.0)


def norm(a: Position, b: Position = (0.0, 0.0, 0.0)) -> float:
    return float(np.linalg.norm(np.subtract(a, b)))


@given(start=POINT.filter(BOX.contains), target=POINT, duration=st.floats(0.1, 5.0))
def test_clipped_target_is_on_the_line_in_the_box_and_slow(start: Position, target: Position, duration: float) -> None:
    sent = BOX.clip(start, target, duration)
    assert sent.duration_s == duration
    assert BOX.contains(sent.target)
    assert norm(start, sent.target) + norm(sent.target, target) == pytest.approx(norm(start, target), abs=1e-6)
    assert PEAK_SPEED * norm(start, sent.target) / duration <= BOX.max_speed_m_s * (1 + 1e-9)
    if BOX.contains(target) and PEAK_SPEED * norm(start, target) / duration < BOX.max_speed_m_s * (1 - 1e-9):
        assert sent.target == target


def test_from_outside_the_box_a_robot_comes_back_in() -> None:
    sent = BOX.clip((2.5, 0.0, 1.0), (5.0, 1.0, 1.0), 10.0)
    assert sent.target == (2.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("limits", "cause"),
    [({"low": (1.0, 0.0, 0.0), "high": (0.0, 1.0, 1.0)}, "^low = "), ({"max_speed_m_s": 0.0}, "^max_speed_m_s = ")],
)
def test_motion_limits_reject_invalid_values(limits: dict[str, Any], cause: str) -> None:
    with pytest.raises(InputError, match=cause):
        MotionLimits(**limits)


def test_motion_limits_reject_a_duration_of_zero() -> None:
    with pytest.raises(InputError, match=r"^duration_s = "):
        BOX.clip((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.0)
