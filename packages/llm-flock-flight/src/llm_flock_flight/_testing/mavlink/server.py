"""Stand-in autopilots behind UDP sockets."""

from __future__ import annotations

import contextlib
import random
import socket
import threading
import time
from collections import deque
from collections.abc import Sequence

import numpy as np

from llm_flock.robots import Position
from llm_flock_flight._mavlink.codec import GROUND_STATION, Codec
from llm_flock_flight._mavlink.frames import enu
from llm_flock_flight._testing.mavlink.autopilot import Autopilot
from llm_flock_flight._testing.serving import ServedTeam

PORTS = (20_000, 32_000)  # of drivers: below those that systems choose by themselves
STEP_S = 0.005  # time between two steps of the vehicles [s]


class AutopilotStandIn:
    """One vehicle: call anything here while it flies, from any thread. `autopilot` only `with vehicle.lock`.

    `loss` is the share of packets lost in each direction, and `delay_s` how late the others come [s]; `silent` loses
    all of them, `deaf` those towards it.
    """

    def __init__(
        self,
        uri: str,
        home: Position,
        autopilot: Autopilot,
        system_id: int,
        calls: tuple[str, int] | None,
        loss: float,
        rng: np.random.Generator,
    ) -> None:
        self.uri, self.system_id, self.autopilot = uri, system_id, autopilot
        self.flavour = "px4" if autopilot.px4 else "ardupilot"
        self.loss, self.silent, self.deaf, self.delay_s = loss, False, False, 0.0
        self.lock = threading.Lock()
        self._home = home
        self._rng = rng
        self._calls = self._peer = calls
        self._coming: deque[tuple[float, bytes]] = deque()
        self._going: deque[tuple[float, bytes]] = deque()
        self._codec = Codec()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)

    @property
    def position(self) -> Position:
        """The body's position [m; world frame]."""
        with self.lock:
            x, y, z = (a + b for a, b in zip(self._home, enu(self.autopilot.body.ned), strict=True))
        return (x, y, z)

    @property
    def armed(self) -> bool:
        with self.lock:
            return self.autopilot.armed

    @property
    def mode(self) -> str:
        with self.lock:
            return self.autopilot.flavour.name_of(self.autopilot.mode)

    def switch(self, mode: str) -> None:
        """Change the mode by its name, as a pilot does by radio."""
        with self.lock:
            modes = {name: number for number, name in self.autopilot.flavour.names.items()}
            self.autopilot.switch(modes[mode])

    def die(self) -> None:
        """Let the autopilot end: the vehicle falls, and is silent."""
        self.silent = True
        with self.lock:
            self.autopilot.restart()

    # The rest is for the thread that serves it.

    def receive(self) -> None:
        """Take all packets that have arrived."""
        while True:
            try:
                data, peer = self.socket.recvfrom(4096)
            except (BlockingIOError, ConnectionError):
                break
            if self.silent or self.deaf or self._loses_packet():
                continue
            if self._calls is None:
                self._peer = peer
            elif peer[1] != self._calls[1]:
                continue  # a late packet for an earlier program on this port must not turn it away from its driver
            self._coming.append((time.monotonic() + self.delay_s, data))
        self._take()

    def _take(self) -> None:
        while self._coming and self._coming[0][0] <= time.monotonic():
            for message in self._codec.datagram(self._coming.popleft()[1]):
                if int(message.get_srcSystem()) == GROUND_STATION:
                    with self.lock:
                        answers = self.autopilot.handle(message, time.monotonic())
                    self._send(answers)

    def tick(self) -> None:
        """Fly on, and send what is due."""
        self._take()
        with self.lock:
            due = self.autopilot.tick(time.monotonic())
        self._send(due)

    def _loses_packet(self) -> bool:
        return self.loss > 0.0 and bool(self._rng.random() < self.loss)

    def _send(self, packets: Sequence[bytes]) -> None:
        self._going.extend((time.monotonic() + self.delay_s, packet) for packet in packets)
        while self._going and self._going[0][0] <= time.monotonic():
            packet = self._going.popleft()[1]
            if self._peer is not None and not self.silent and not self._loses_packet():
                with contextlib.suppress(BlockingIOError, ConnectionError):
                    self.socket.sendto(packet, self._peer)


class AutopilotStandIns(ServedTeam[AutopilotStandIn]):
    """Several stand-ins, served from `__enter__` to `__exit__`.

    They start at `homes` [m; world frame], the zeros of their local frames, and call the driver at `host`: if `shared`
    all at one port, with system ids 1, 2 and so on; otherwise each at its own, from `port` on (0: free ones). When
    `listening` they wait to be called instead, at `udpout://`. `lifelike` as of `Autopilot`.
    """

    def __init__(
        self,
        homes: Sequence[Position],
        *,
        flavour: str = "px4",
        host: str = "127.0.0.1",
        port: int = 0,
        shared: bool = False,
        listening: bool = False,
        loss: float = 0.0,
        seed: int = 0,
        lifelike: bool = False,
    ) -> None:
        super().__init__(STEP_S)
        rng = np.random.default_rng(seed)
        ports = [port] * len(homes) if shared else [port + k if port else 0 for k in range(len(homes))]
        if not port and not listening:
            ports = _free_ports(host, 1) * len(homes) if shared else _free_ports(host, len(homes))
        for k, (home, at) in enumerate(zip(homes, ports, strict=True)):
            autopilot = Autopilot(flavour, k + 1, lifelike=lifelike)
            calls = None if listening else (host, at)
            vehicle = AutopilotStandIn(f"udp://{host}:{at}", home, autopilot, k + 1, calls, loss, rng)
            if listening:
                vehicle.socket.bind((host, at))
                vehicle.uri = f"udpout://{host}:{vehicle.socket.getsockname()[1]}"
            self._members.append(vehicle)


def _free_ports(host: str, count: int) -> list[int]:
    """Free UDP ports, of a range from which no system hands out ports before the driver is there."""
    found: list[int] = []
    for port in random.SystemRandom().sample(range(*PORTS), PORTS[1] - PORTS[0]):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one, contextlib.suppress(OSError):
            one.bind((host, port))
            found.append(port)
        if len(found) == count:
            return found
    raise OSError(f"fewer than {count} free ports at {host}")
