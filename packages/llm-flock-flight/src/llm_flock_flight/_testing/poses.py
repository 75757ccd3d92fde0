"""A stand-in for a motion capture: streams the poses of stand-in drones as UDP datagrams, with faults on request.

from llm_flock_flight._testing.poses import PoseStream

with PoseStream(("127.0.0.1", 19700), {"cf1": lambda: drones[0].position}) as stream:
    stream.swapped = ("cf1", "cf2")  # from now on each has the other's markers
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Mapping

import numpy as np

from llm_flock.robots import Pose, PoseFrame, Position
from llm_flock_flight._positions.udp import datagram_of


class PoseStream:
    """Streams where `places` says that each drone is [m], until its context ends.

    `noise_m` is the standard deviation of each coordinate [m]: a flight takes poses without any noise for frozen ones.
    Set the faults: `silent`, drones `hidden`, two whose markers are `swapped`, and `frozen` ones, whose last pose is
    repeated.
    """

    def __init__(
        self,
        address: tuple[str, int],
        places: Mapping[str, Callable[[], Position]],
        *,
        rate_hz: float = 100.0,
        noise_m: float = 0.0005,
        seed: int = 0,
    ) -> None:
        self.silent = False
        self.hidden: frozenset[str] = frozenset()
        self.swapped: tuple[str, str] | None = None
        self.frozen: frozenset[str] = frozenset()
        self._last: dict[str, Position] = {}
        self.sent = 0
        self._address = address
        self._places = places
        self._period_s = 1.0 / rate_hz
        self._noise_m = noise_m
        self._rng = np.random.default_rng(seed)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._stream, name="poses", daemon=True)

    def __enter__(self) -> PoseStream:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def frame(self, stamp_s: float) -> PoseFrame:
        """The poses seen now, faults included."""
        seen = {name: self._noisy(place()) for name, place in self._places.items() if name not in self.hidden}
        seen |= {name: self._last[name] for name in self.frozen & seen.keys() & self._last.keys()}
        self._last = dict(seen)
        if self.swapped is not None:
            one, two = self.swapped
            seen[one], seen[two] = seen[two], seen[one]
        return PoseFrame(stamp_s=stamp_s, poses={name: Pose(place) for name, place in seen.items()})

    def _noisy(self, place: Position) -> Position:
        x, y, z = (value + self._noise_m * float(self._rng.standard_normal()) for value in place)
        return (x, y, z)

    def _stream(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.connect(self._address)
            while not self._stop.wait(self._period_s):
                if not self.silent:
                    with contextlib.suppress(OSError):  # no program listens yet
                        sender.send(datagram_of(self.frame(time.monotonic())))
                        self.sent += 1
