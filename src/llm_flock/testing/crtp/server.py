"""The UDP side of the stand-ins: one socket a drone, one thread for all of them."""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
import time
from collections.abc import Sequence

import numpy as np

from llm_flock.robots.base import Position
from llm_flock.robots.point_mass import PointMass
from llm_flock.testing.crtp.firmware import Firmware

STEP_S = 0.002
"""How exactly log packets keep their times [s]."""

LARGEST = 64


class StandIn:
    """One drone behind one socket. Everything here may be called while it flies, from any thread.

    Attributes:
        uri: where cflib finds it.
        loss: share of packets lost, in each direction.
        firmware: what answers.
    """

    def __init__(self, host: str, port: int, body: PointMass, loss: float, rng: np.random.Generator) -> None:
        self.firmware = Firmware(body)
        self.loss = loss
        self._lock = threading.Lock()
        self._rng = rng
        self._silent = self._mute = False
        self._peer: tuple[str, int] | None = None
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self.socket.bind((host, port))
        except OSError:
            self.socket.close()
            raise
        self.socket.setblocking(False)
        self.uri = f"udp://{host}:{self.socket.getsockname()[1]}"

    # ------------------------------------------------------------ what can be seen of it

    @property
    def position(self) -> Position:
        """Where the body really is now [m]."""
        with self._lock:
            return self.firmware.body.position(time.monotonic())

    @property
    def flying(self) -> bool:
        """Motors turn."""
        with self._lock:
            self.firmware.body.advance(time.monotonic())
            return self.firmware.body.flying

    @property
    def locked(self) -> bool:
        """An emergency stop has come, or the supervisor gave up."""
        with self._lock:
            self.firmware.tick(time.monotonic())
            return self.firmware.body.locked

    # ------------------------------------------------------------ what goes wrong

    def lose_link(self, lost: bool = True) -> None:
        """Nothing gets through in either direction; the drone flies on. Or all gets through again."""
        with self._lock:
            self._silent = lost

    def die(self) -> None:
        """The drone fails: it falls, and says nothing more."""
        with self._lock:
            self._silent = True
            self.firmware.body.emergency_stop(time.monotonic())

    def mute_log(self, mute: bool = True) -> None:
        """Log packets come no more while all else is answered; or come again."""
        with self._lock:
            self._mute = mute

    def set_battery(self, volts: float) -> None:
        """[V]."""
        with self._lock:
            self.firmware.body.battery_v = volts

    def jump(self, offset: Position) -> None:
        """The position estimate is off by that much from now on [m]."""
        with self._lock:
            self.firmware.body.jump(offset, time.monotonic())

    def stall(self, stalled: bool = True) -> None:
        """The position estimate stands still and its variance grows; or works again."""
        with self._lock:
            self.firmware.body.stall(time.monotonic(), stalled)

    # ------------------------------------------------------------ for the thread that serves it

    def receive(self) -> None:
        """Answer everything that has come."""
        while True:
            try:
                data, peer = self.socket.recvfrom(LARGEST)
            except (BlockingIOError, ConnectionError):
                return
            with self._lock:
                if self._silent or self._lost():
                    continue
                self._peer = peer
                for answer in self.firmware.handle(data, time.monotonic()):
                    self._send(answer)

    def tick(self) -> None:
        """Send what is due."""
        with self._lock:
            due = self.firmware.tick(time.monotonic())
            if not self._silent and not self._mute:
                for packet in due:
                    self._send(packet)

    def _lost(self) -> bool:
        return self.loss > 0.0 and bool(self._rng.random() < self.loss)

    def _send(self, data: bytes) -> None:
        if self._peer is not None and not self._lost():
            with contextlib.suppress(BlockingIOError, ConnectionError):
                self.socket.sendto(data, self._peer)


class StandIns:
    """Several stand-ins and the thread that serves them, from `__enter__` to `__exit__`.

    Args:
        homes: where they stand at first [m], one each.
        host: address to listen at.
        port: of the first; the others follow. 0 takes free ones.
        loss: share of packets lost, in each direction.
        auto_arm: as Crazyflies 2.1 are shipped: armed from the start.
        seed: of what is lost.
    """

    def __init__(
        self,
        homes: Sequence[Position],
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        loss: float = 0.0,
        auto_arm: bool = False,
        seed: int = 0,
    ) -> None:
        self._drones: list[StandIn] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="stand-ins", daemon=True)
        rng = np.random.default_rng(seed)
        try:
            for k, home in enumerate(homes):
                body = PointMass(home=home, ground_m=home[2], auto_arm=auto_arm)
                self._drones.append(StandIn(host, port + k if port else 0, body, loss, rng))
        except OSError:
            self._close()
            raise

    @property
    def uris(self) -> list[str]:
        """Where cflib finds them."""
        return [drone.uri for drone in self._drones]

    def __getitem__(self, index: int) -> StandIn:
        return self._drones[index]

    def __len__(self) -> int:
        return len(self._drones)

    def __enter__(self) -> StandIns:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._close()

    def _close(self) -> None:
        for drone in self._drones:
            drone.socket.close()

    def _serve(self) -> None:
        with selectors.DefaultSelector() as selector:
            for drone in self._drones:
                selector.register(drone.socket, selectors.EVENT_READ, drone)
            due = time.monotonic()
            while not self._stop.is_set():
                for key, _ in selector.select(max(0.0, due - time.monotonic())):
                    key.data.receive()
                if time.monotonic() >= due:
                    due = time.monotonic() + STEP_S
                    for drone in self._drones:
                        drone.tick()
