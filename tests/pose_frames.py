"""Poses from outside as tests write them: limits, names, frames and datagrams."""

from __future__ import annotations

import json
from typing import Any

import pytest

from llm_flock.errors import MessageError
from llm_flock.robots._base import Pose, PoseFrame
from llm_flock_flight._flight.sections import PositionsConfig

LIMITS = PositionsConfig(pose_late_s=0.1, pose_lost_s=0.5, pose_jump_m=0.1, pose_frozen_s=0.0)
NAMES = ("a", "b", "c")


def reason(call: Any, *arguments: Any) -> str:
    """Why a call refuses what it is given."""
    with pytest.raises(MessageError) as found:
        call(*arguments)
    return found.value.reason


def text(**fields: Any) -> bytes:
    """A datagram about drone a with these fields."""
    return json.dumps({"time": 1.0, "poses": [{"name": "a", "position": [0, 0, 0], **fields}]}).encode()


def frame(stamp_s: float, **places: Any) -> PoseFrame:
    """Poses of drones at places [m]."""
    return PoseFrame(stamp_s=stamp_s, poses={name: Pose(at) for name, at in places.items()})
