"""The external pose port: frames of poses as UDP datagrams from any sender, one JSON object each.

{"time": 12.34, "poses": [{"name": "cf1", "position": [0.1, 0.2, 0.9], "quaternion": [0, 0, 0, 1]}]}

docs/how-to/positions.md describes the format. Invalid input is counted and dropped. The first sender of a usable
datagram is followed until it is silent for `SILENT_S`; meanwhile datagrams of others are dropped unread, so that a
flood of theirs costs little.
"""

from __future__ import annotations

import asyncio
import math
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Annotated, Any

import msgspec

from llm_flock.errors import InputError, MessageError
from llm_flock.robots import Pose, PoseFrame
from llm_flock_flight._mavlink.port import RateLimit
from llm_flock_flight._positions.gate import UNKNOWN

SILENT_S = 1.0  # a sender that sends nothing usable for this long may be followed by another one [s]
MAX_PER_SECOND = 2000  # most datagrams that are parsed in a second; the rest are dropped unread
BUFFER_BYTES = 1 << 20  # asked of the system for datagrams that wait to be read [bytes]


MAX_BYTES = 16_384  # largest datagram that is read: more than a hundred drones [bytes]
MAX_POSES = 256  # most poses of one datagram
MAX_DISTANCE_M = 1000.0  # largest coordinate that is believed [m]

_Name = Annotated[str, msgspec.Meta(min_length=1, max_length=64)]


class _PoseText(msgspec.Struct, forbid_unknown_fields=True):
    name: _Name
    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float] | None = None


class _FrameText(msgspec.Struct, forbid_unknown_fields=True):
    time: float
    poses: Annotated[list[_PoseText], msgspec.Meta(min_length=1, max_length=MAX_POSES)]


_DECODER = msgspec.json.Decoder(_FrameText)


def frame_of(data: bytes) -> PoseFrame:
    """The frame in a datagram, or MessageError: oversized, malformed, out_of_range, or not_unit for a quaternion."""
    if len(data) > MAX_BYTES:
        raise MessageError("oversized", f"{len(data)} bytes")
    try:
        found = _DECODER.decode(data)
    except (msgspec.DecodeError, RecursionError, ValueError) as error:
        raise MessageError("malformed", str(error)[:200]) from None
    if not abs(found.time) <= 1e12:
        raise MessageError("out_of_range", f"time {found.time:g} s")
    poses = {pose.name: _pose(pose) for pose in found.poses}
    if len(poses) != len(found.poses):
        raise MessageError("malformed", "a name stands there twice")
    return PoseFrame(stamp_s=found.time, poses=poses)


def _pose(text: _PoseText) -> Pose:
    if not all(abs(x) <= MAX_DISTANCE_M for x in text.position):
        raise MessageError("out_of_range", f"position {text.position}")
    if text.quaternion is not None and not abs(math.hypot(*text.quaternion) - 1.0) <= 0.01:
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


class UdpPoses:
    """A source that listens at an address of this machine; `port` 0 becomes a free one.

    A datagram with none of the drones' `names` is a stranger's, whom it would be wrong to follow.
    """

    def __init__(self, host: str, port: int, names: Iterable[str]) -> None:
        self.refused: Counter[str] = Counter()
        self.port = port
        self._host = host
        self._names = frozenset(names)
        self._socket: socket.socket | None = None
        self._take: Callable[[PoseFrame], None] | None = None
        self._followed: tuple[Any, float] | None = None
        self._other: tuple[Any, float] | None = None
        self._parsed = RateLimit(MAX_PER_SECOND)

    async def open(self, take: Callable[[PoseFrame], None]) -> None:
        """Listen from now on; raises InputError if the address is not of this machine, or taken."""
        loop = asyncio.get_running_loop()
        try:
            family = (await loop.getaddrinfo(self._host, self.port, type=socket.SOCK_DGRAM))[0][0]
            found = socket.socket(family, socket.SOCK_DGRAM)
        except OSError as error:
            raise InputError("pose_host", self._host, f"an address of this machine ({error.strerror})") from None
        except ValueError:  # no host name, by its letters or their number
            raise InputError("pose_host", self._host, "an address of this machine") from None
        try:
            found.setblocking(False)
            found.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            found.bind((self._host, self.port))
        except OSError as error:
            found.close()
            raise InputError(
                "pose_port",
                self.port,
                f"a free UDP port at {self._host}, an address of this machine ({error.strerror})",
            ) from None
        self._socket, self._take = found, take
        self.port = int(found.getsockname()[1])
        loop.add_reader(found, self._read)

    async def close(self) -> None:
        found, self._socket = self._socket, None
        if found is not None:
            asyncio.get_running_loop().remove_reader(found)
            found.close()

    def _read(self) -> None:
        for _ in range(256):  # then the event loop may do something else
            if self._socket is None:
                return
            try:
                data, sender = self._socket.recvfrom(MAX_BYTES + 1)
            except (BlockingIOError, InterruptedError):
                return
            except OSError:  # an ICMP error of a packet that was not sent from here
                continue
            try:
                self.hear(data, sender, time.monotonic())
            except MessageError as error:
                self.refused[error.reason] += 1

    def senders(self, now: float) -> tuple[str, ...]:
        """Addresses that were heard in the last `SILENT_S`: the one that is followed, and the newest of the others."""
        heard = [found for found in (self._followed, self._other) if found is not None]
        return tuple(_in_words(sender) for sender, heard_s in heard if now - heard_s < SILENT_S)

    def hear(self, data: bytes, sender: Any, now: float) -> None:
        """Take one datagram; raises MessageError: second_sender, too_many, unknown_name, or as `frame_of`."""
        if self._followed is not None and sender != self._followed[0] and now - self._followed[1] < SILENT_S:
            self._other = sender, now
            raise MessageError("second_sender", f"{sender} sends as well")
        if not self._parsed.allows(now):
            raise MessageError("too_many", f"more than {MAX_PER_SECOND} a second")
        frame = frame_of(data)
        if self._names.isdisjoint(frame.poses):
            raise MessageError(UNKNOWN, "none of these names is a drone's")
        self._followed = sender, now
        if self._other is not None and self._other[0] == sender:
            self._other = None
        if self._take is not None:
            self._take(frame)


def _in_words(sender: Any) -> str:
    """An address as people write it."""
    return f"{sender[0]}:{sender[1]}" if isinstance(sender, tuple) else str(sender)
