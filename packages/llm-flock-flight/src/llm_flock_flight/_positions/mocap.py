"""Motion capture through libmotioncapture: Vicon, OptiTrack, Qualisys and VRPN, by the package `motioncapture`.

The library runs in a process of its own, and sends its frames to a free external pose port of this machine. It waits
for its system without a time limit, while it connects even with Python's interpreter lock, and it is native code: none
of that may stop a flight's event loop or end its process.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import os
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from llm_flock.extras import require
from llm_flock.robots import Pose, PoseFrame
from llm_flock_flight._positions.udp import MAX_DISTANCE_M, MAX_POSES, UdpPoses, datagram_of

HOST = "127.0.0.1"


FAREWELL_S = 2.0  # longest wait for the process to end [s]


class MocapPoses:
    """A source that follows a motion capture, whose rigid bodies have the drones' names.

    Its system is vicon, optitrack, qualisys, vrpn or mock: those that the wheels of motioncapture 1.1 know.
    """

    def __init__(self, system: str, host: str, names: Iterable[str]) -> None:
        self._system, self._host, self._names = system, host, tuple(names)
        self._port = UdpPoses(HOST, 0, self._names)
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def refused(self) -> Counter[str]:
        """Input that was dropped, by reason; and `mocap_ended` if the process has ended."""
        ended = self._process is not None and self._process.poll() is not None
        return self._port.refused + Counter({"mocap_ended": int(ended)})

    def senders(self, now: float) -> tuple[str, ...]:
        """The senders to the port between the process and this one: only the process."""
        return self._port.senders(now)

    async def open(self, take: Callable[[PoseFrame], None]) -> None:
        """Start the process, or raise InputError. Whether the system answers shows only in the poses."""
        require("mocap", "positions by a motion capture")
        await self._port.open(take)
        self._process = self._start()

    def _start(self) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", __name__, self._system, self._host, str(self._port.port), *self._names]
        return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)

    async def close(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            assert process.stdin is not None
            process.stdin.close()
            await asyncio.to_thread(_wait_for_end, process)
        await self._port.close()


def _wait_for_end(process: subprocess.Popen[bytes]) -> None:
    try:
        process.wait(FAREWELL_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def frame_of_bodies(bodies: Mapping[str, Any], names: frozenset[str], stamp_s: float) -> PoseFrame | None:
    """The drones among rigid bodies; None if there is none. Bodies that are not seen may be NaN: they are left out."""
    poses: dict[str, Pose] = {}
    for name, body in bodies.items():
        x, y, z = (float(value) for value in body.position)
        if name in names and len(poses) < MAX_POSES and all(abs(value) <= MAX_DISTANCE_M for value in (x, y, z)):
            turn = body.rotation
            poses[name] = Pose((x, y, z), (float(turn.x), float(turn.y), float(turn.z), float(turn.w)))
    return PoseFrame(stamp_s=stamp_s, poses=poses) if poses else None


def forward(system: str, host: str, port: int, names: frozenset[str]) -> None:
    """Send every frame of a motion capture to the port, without end."""
    library: Any = importlib.import_module("motioncapture")
    found = library.connect(system, {"hostname": host})
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect((HOST, port))
        while True:
            found.waitForNextFrame()
            frame = frame_of_bodies(found.rigidBodies, names, time.monotonic())
            if frame is not None:
                with contextlib.suppress(OSError):  # no process listens any more: the pipe closes too
                    sender.send(datagram_of(frame))


def _end_with_parent() -> None:
    """End this process when the pipe from its parent closes, even while the library waits."""
    while os.read(0, 64):  # not by sys.stdin, whose lock would be held when this process ends by itself
        pass
    os._exit(0)


def main(arguments: list[str]) -> int:
    """`python -m llm_flock_flight._positions.mocap SYSTEM HOST PORT NAME...`, started by `MocapPoses`."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    system, host, port, *names = arguments
    try:
        forward(system, host, int(port), frozenset(names))
    except RuntimeError as error:  # of the library: an unknown system, or no server there
        sys.stderr.write(f"motion capture: {error}\n")
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
