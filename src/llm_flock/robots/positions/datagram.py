"""The format of external poses: one JSON object a datagram. docs/how-to/positions.md describes it.

{"time": 12.34, "poses": [{"name": "cf1", "position": [0.1, 0.2, 0.9], "quaternion": [0, 0, 0, 1]}]}
"""

from __future__ import annotations

import math
from typing import Annotated, Any

import msgspec

from llm_flock.errors import MessageError
from llm_flock.robots.pose import Pose, PoseFrame

MOST_BYTES = 16_384
"""Largest datagram that is read: more than a hundred drones [bytes]."""

MOST_POSES = 256
"""Most poses of one datagram."""

MOST_M = 1000.0
"""Largest coordinate that is believed [m]."""

MOST_S = 1e12
"""Largest time stamp that is believed [s]."""

UNIT = 0.01
"""Largest deviation of a quaternion's length from 1."""

_Name = Annotated[str, msgspec.Meta(min_length=1, max_length=64)]


class _PoseText(msgspec.Struct, forbid_unknown_fields=True):
    name: _Name
    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float] | None = None


class _FrameText(msgspec.Struct, forbid_unknown_fields=True):
    time: float
    poses: Annotated[list[_PoseText], msgspec.Meta(min_length=1, max_length=MOST_POSES)]


_DECODER = msgspec.json.Decoder(_FrameText)


def frame_of(data: bytes) -> PoseFrame:
    """The frame in a datagram.

    Raises:
        MessageError: `oversized`, `malformed` (not JSON of this form, or a name twice), `out_of_range` (a coordinate or
            a time too large), or `not_unit` (a quaternion that is no rotation). JSON has no NaN and no infinity.
    """
    if len(data) > MOST_BYTES:
        raise MessageError("oversized", f"{len(data)} bytes")
    try:
        found = _DECODER.decode(data)
    except (msgspec.DecodeError, RecursionError, ValueError) as error:
        raise MessageError("malformed", str(error)[:200]) from None
    if not abs(found.time) <= MOST_S:
        raise MessageError("out_of_range", f"time {found.time:g} s")
    poses = {pose.name: _pose(pose) for pose in found.poses}
    if len(poses) != len(found.poses):
        raise MessageError("malformed", "a name stands there twice")
    return PoseFrame(stamp_s=found.time, poses=poses)


def _pose(text: _PoseText) -> Pose:
    if not all(abs(x) <= MOST_M for x in text.position):
        raise MessageError("out_of_range", f"position {text.position}")
    if text.quaternion is not None and not abs(math.hypot(*text.quaternion) - 1.0) <= UNIT:
        raise MessageError("not_unit", f"quaternion {text.quaternion}")
    return Pose(text.position, text.quaternion)


def datagram_of(frame: PoseFrame) -> bytes:
    """The datagram of a frame; see `frame_of`."""
    rows: list[dict[str, Any]] = []
    for name, pose in frame.poses.items():
        row: dict[str, Any] = {"name": name, "position": pose.position}
        if pose.quaternion is not None:
            row["quaternion"] = pose.quaternion
        rows.append(row)
    return msgspec.json.encode({"time": frame.stamp_s, "poses": rows})
