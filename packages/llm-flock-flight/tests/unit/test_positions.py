"""Poses from outside: what is read, what a drone can have flown, and what is sent; without sockets or drones."""

from __future__ import annotations

import contextlib
import json
import math
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pose_frames import LIMITS, NAMES, frame, reason, text

from llm_flock.errors import MessageError
from llm_flock.robots._base import Pose, PoseFrame
from llm_flock_flight._positions import PoseGate
from llm_flock_flight._positions.udp import (
    MAX_BYTES,
    MAX_PER_SECOND,
    MAX_POSES,
    SILENT_S,
    UdpPoses,
    datagram_of,
    frame_of,
)

# ------------------------------------------------------------------ datagrams


def test_written_frame_is_read_back() -> None:
    sent = PoseFrame(
        stamp_s=12.5, poses={"a": Pose((1.0, -2.0, 0.5), (0.0, 0.0, 0.6, 0.8)), "b": Pose((0.0, 0.0, 0.0))}
    )
    assert frame_of(datagram_of(sent)) == sent


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "malformed"),
        (b"\xff\xfe\x00", "malformed"),
        (b"[]", "malformed"),
        (b'{"time": 1.0, "poses": []}', "malformed"),
        (b'{"time": 1.0, "poses": {}}', "malformed"),
        (b'{"poses": [{"name": "a", "position": [0, 0, 0]}]}', "malformed"),
        (b'{"time": "1", "poses": [{"name": "a", "position": [0, 0, 0]}]}', "malformed"),
        (text(name=""), "malformed"),
        (text(name="x" * 65), "malformed"),
        (text(name=3), "malformed"),
        (text(position=[0, 0]), "malformed"),
        (text(position=[0, 0, 0, 0]), "malformed"),
        (text(position=[0, 0, True]), "malformed"),
        (text(position=[0, 0, math.nan]), "malformed"),
        (text(position=[0, 0, math.inf]), "malformed"),
        (text(speed=3), "malformed"),
        (text().replace(b"[0, 0, 0]", b"[0, 0, 1e999]"), "malformed"),
        (text().replace(b"1.0", b"1e300"), "out_of_range"),
        (text(position=[0, 0, 1001]), "out_of_range"),
        (text(quaternion=[0, 0, 0, 0]), "not_unit"),
        (text(quaternion=[1, 1, 1, 1]), "not_unit"),
        (text(quaternion=[0, 0, 1]), "malformed"),
        (b"[" * 10_000, "malformed"),
        (text() + b" " * MAX_BYTES, "oversized"),
        (json.dumps({"time": 1.0, "poses": [{"name": "a", "position": [0, 0, 0]}] * 2}).encode(), "malformed"),
    ],
)
def test_anything_else_is_refused(data: bytes, why: str) -> None:
    assert reason(frame_of, data) == why


def test_more_poses_than_a_frame_may_have_are_refused() -> None:
    rows = [{"name": f"{k}", "position": [0, 0, 0]} for k in range(MAX_POSES + 1)]
    assert reason(frame_of, json.dumps({"time": 0, "poses": rows}).encode()) == "malformed"


@given(st.binary(max_size=400))
def test_no_bytes_do_more_than_be_refused(data: bytes) -> None:
    with contextlib.suppress(MessageError):
        frame_of(data)


# ------------------------------------------------------------------ the port


def port() -> tuple[UdpPoses, list[PoseFrame]]:
    """A port that is open for `hear`, without a socket."""
    found, frames = UdpPoses("127.0.0.1", 0, NAMES), list[PoseFrame]()
    found._take = frames.append
    return found, frames


def test_the_first_sender_is_followed_until_it_is_silent() -> None:
    found, frames = port()
    found.hear(text(), "here", 10.0)
    assert reason(found.hear, text(), "elsewhere", 10.0 + 0.9 * SILENT_S) == "second_sender"
    found.hear(text(), "elsewhere", 10.0 + 1.1 * SILENT_S)
    assert reason(found.hear, text(), "here", 10.0 + 1.2 * SILENT_S) == "second_sender"
    assert len(frames) == 2


def test_a_second_sender_is_named_until_one_of_the_two_is_silent() -> None:
    found, _ = port()
    one, two = ("127.0.0.1", 5001), ("127.0.0.1", 5002)
    assert found.senders(10.0) == ()
    found.hear(text(), one, 10.0)
    assert reason(found.hear, text(), two, 10.5) == "second_sender"
    assert found.senders(10.6) == ("127.0.0.1:5001", "127.0.0.1:5002")
    found.hear(text(), two, 11.2)
    assert found.senders(11.3) == ("127.0.0.1:5002",)


def test_poses_of_an_unknown_sender_are_never_used() -> None:
    found, frames = port()
    assert reason(found.hear, b"garbage", "stranger", 10.0) == "malformed"
    assert reason(found.hear, text(name="nobody"), "stranger", 10.0) == "unknown_name"
    found.hear(text(), "here", 10.0)
    assert len(frames) == 1


def test_a_flood_is_not_parsed() -> None:
    found, frames = port()
    refused = Counter[str]()
    for _ in range(MAX_PER_SECOND + 100):
        try:
            found.hear(text(), "here", 10.5)
        except MessageError as error:
            refused[error.reason] += 1
    assert len(frames) == MAX_PER_SECOND and refused == {"too_many": 100}
    found.hear(text(), "here", 11.0)
    assert len(frames) == MAX_PER_SECOND + 1
    for _ in range(10 * MAX_PER_SECOND):  # a stranger's flood is not even counted against the one who is followed
        assert reason(found.hear, b"x", "stranger", 11.1) == "second_sender"
    found.hear(text(), "here", 11.2)
    assert len(frames) == MAX_PER_SECOND + 2


# ------------------------------------------------------------------ the gate


def gate(**limits: float) -> PoseGate:
    changed = {f"pose_{name}": value for name, value in limits.items() if name != "speed_m_s"}
    return PoseGate(NAMES, LIMITS.model_copy(update=changed), limits.get("speed_m_s", 1.0))


def test_a_drone_that_flies_is_let_through() -> None:
    found = gate()
    for k in range(200):
        t = k / 100
        assert set(found.take(frame(t, a=(t, 0.0, 1.0), b=(t, 0.5, 1.0)), 50.0 + t)) == {"a", "b"}
    assert not found.refused


def test_unknown_names_are_counted_together() -> None:
    found = gate()
    assert set(found.take(frame(0.0, a=(0, 0, 0), x=(0, 0, 0)), 1.0)) == {"a"}
    assert found.refused == {("", "unknown_name"): 1}


def test_late_and_reordered_poses_are_rejected() -> None:
    found = gate()
    assert found.take(frame(5.0, a=(0, 0, 0)), 100.0)
    assert found.take(frame(5.1, a=(0, 0, 0)), 100.19)
    assert not found.take(frame(5.2, a=(0, 0, 0)), 100.31)
    assert not found.take(frame(5.05, a=(0, 0, 0)), 100.06)
    assert not found.take(frame(5.1, a=(0, 0, 0)), 100.19)
    assert found.refused == {("a", "late"): 1, ("a", "out_of_order"): 2}


def test_sender_with_a_restarted_clock_is_believed_on_ground() -> None:
    for flying in (False, True):
        found = gate()
        found.take(frame(500.0, a=(0, 0, 0)), 10.0)
        found.flying = flying
        first = found.take(frame(0.0, a=(0, 0, 0)), 12.0)
        assert bool(first) is not flying


def test_a_jump_is_refused_and_speed_is_not() -> None:
    found = gate()
    found.take(frame(0.0, a=(0, 0, 0)), 10.0)
    assert not found.take(frame(0.1, a=(0.21, 0, 0)), 10.1)
    assert found.take(frame(0.2, a=(0.29, 0, 0)), 10.2)
    assert found.refused == {("a", "jump"): 1}


def test_a_jump_that_lasts_is_never_believed_in_flight() -> None:
    found = gate()
    found.take(frame(0.0, a=(0, 0, 0)), 10.0)
    found.flying = True
    assert not any(found.take(frame(k / 100, a=(0.7, 0, 0)), 10 + k / 100) for k in range(1, 2000))
    on_the_ground = gate()
    on_the_ground.take(frame(0.0, a=(0, 0, 0)), 10.0)
    assert any(on_the_ground.take(frame(k / 100, a=(0.7, 0, 0)), 10 + k / 100) for k in range(1, 100))


def test_swapped_markers_are_not_believed_and_drones_are_named() -> None:
    named: list[tuple[str, str]] = []
    found = gate(jump_m=0.5)  # so that no jump is seen: the drones are 0.3 m apart
    found.on_refusal = lambda name, why: named.append((name, why))
    found.take(frame(0.0, a=(0, 0, 1), b=(0.3, 0, 1), c=(2, 0, 1)), 10.0)
    found.flying = True
    for k in range(1, 300):
        t = k / 100
        assert set(found.take(frame(t, a=(0.3, 0, 1), b=(0, 0, 1), c=(2, 0, 1)), 10.0 + t)) == {"c"}
    assert named == [("a", "swap"), ("b", "swap")] and found.refused["a", "swap"] == 299
    assert set(found.take(frame(3.0, a=(0, 0, 1), b=(0.3, 0, 1)), 13.0)) == {"a", "b"}


def test_one_drone_that_is_taken_for_another_is_never_believed() -> None:
    """The label of a lies on b for good, whether b is seen too or not."""
    for others in ({}, {"b": (0.3, 0, 1)}):
        found = gate()
        found.take(frame(0.0, a=(0, 0, 1), b=(0.3, 0, 1)), 10.0)
        found.flying = True
        assert not any("a" in found.take(frame(k / 100, a=(0.3, 0, 1), **others), 10 + k / 100) for k in range(1, 500))


def test_three_drones_whose_markers_go_round_are_refused() -> None:
    found = gate(jump_m=1.0)
    a, b, c = (0, 0, 1), (0.4, 0, 1), (0.2, 0.35, 1)
    found.take(frame(0.0, a=a, b=b, c=c), 10.0)
    assert not found.take(frame(0.01, a=b, b=c, c=a), 10.01)


def test_repeated_pose_is_not_believed_until_it_changes() -> None:
    found = gate(frozen_s=0.5)
    accepted = [sorted(found.take(frame(k / 100, a=(0, 0, 1), b=(k / 1e6, 2, 1)), 10 + k / 100)) for k in range(100)]
    assert accepted[50] == ["a", "b"] and accepted[51:] == [["b"]] * 49
    assert found.refused == {("a", "frozen"): 49} and found.doubts == {"a": "frozen"}
    assert "a" in found.take(frame(1.0, a=(0, 0, 1.0001)), 11.0) and not found.doubts


def test_pose_may_repeat_for_a_moment_or_where_allowed() -> None:
    found = gate(frozen_s=0.5)
    for k in range(400):
        assert found.take(frame(k / 100, a=(0, 0, 1 + (k // 50) / 1000)), 10 + k / 100), "a slow sender, repeated"
    found = gate(frozen_s=0.0)
    assert all(found.take(frame(k / 100, a=(0, 0, 1)), 10 + k / 100) for k in range(400))


# ------------------------------------------------------------------ the feed
