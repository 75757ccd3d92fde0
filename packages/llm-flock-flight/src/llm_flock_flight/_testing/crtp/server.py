"""Stand-ins of drones behind UDP sockets."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Callable, Collection, Sequence
from typing import TypeVar

import numpy as np

from llm_flock.robots import PointMass, Position
from llm_flock_flight._testing.crtp.firmware import COMMANDER, PID, Firmware, packet
from llm_flock_flight._testing.crtp.radio import ModelledRadio
from llm_flock_flight._testing.serving import ServedTeam

STEP_S = 0.002  # time between two checks for log packets that are due [s]

LARGEST = 64

T = TypeVar("T")


class StandIn:
    """One drone behind one socket: its `uri` for cflib, and its `firmware`.

    Call anything here while it flies, from any thread, and set `loss`, the share of packets lost in each direction.
    With `radio` its packets pass a modelled radio, in which it has a number.
    """

    def __init__(
        self,
        host: str,
        port: int,
        firmware: Firmware,
        loss: float,
        rng: np.random.Generator,
        *,
        radio: tuple[ModelledRadio, int] | None = None,
    ) -> None:
        self.firmware = firmware
        self._radio = radio
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

    def _at_once(self, act: Callable[[PointMass, float], T]) -> T:
        """Read or change the body at this time."""
        with self._lock:
            now = time.monotonic()
            self.firmware.advance(now)
            return act(self.firmware.body, now)

    @property
    def position(self) -> Position:
        """True position of the body now [m]."""
        return self._at_once(PointMass.position)

    @property
    def flying(self) -> bool:
        return self._at_once(lambda body, _: body.flying)

    @property
    def locked(self) -> bool:
        """Whether an emergency stop, or the supervisor, has locked the drone."""
        return self._at_once(lambda body, _: body.locked)

    def lose_link(self, lost: bool = True) -> None:
        """Lose every packet, in both directions, while the drone flies on; or none again."""
        self._silent = lost

    def die(self) -> None:
        """Let the drone fail: it falls, and falls silent."""
        self._silent = True
        self._at_once(PointMass.emergency_stop)

    def mute_log(self, mute: bool = True) -> None:
        """Send no log packets while answering everything else; or send them again."""
        self._mute = mute

    def set_battery(self, volts: float) -> None:
        self._at_once(lambda body, _: setattr(body, "battery_v", volts))

    def jump(self, offset: Position) -> None:
        """Shift the position estimate from now on [m]."""
        self._at_once(lambda body, now: body.jump(offset, now))

    def stall(self, stalled: bool = True) -> None:
        """Freeze the position estimate, with growing variance; or let it work again."""
        self._at_once(lambda body, now: body.stall(now, stalled))

    def tumble(self) -> None:
        """Let it lie on its back: the motors stop."""
        self._at_once(lambda _, now: self.firmware.tumble(now))

    def set_parameter(self, name: str, value: float) -> None:
        """Change a firmware parameter behind the client's back."""
        self._at_once(lambda _, now: self.firmware.set_parameter(name, value, now))

    def serve_another_client(self) -> None:
        """Leave the drone as a client of cflib leaves it, that closes its link: with a set-point without thrust."""
        data = packet(COMMANDER, 0, struct.pack("<fffH", 0.0, 0.0, 0.0, 0))
        self._at_once(lambda _, now: self.firmware.handle(data, now))

    # The rest is for the thread that serves it.

    def receive(self) -> None:
        """Answer all packets that have arrived."""
        while True:
            try:
                data, peer = self.socket.recvfrom(LARGEST)
            except (BlockingIOError, ConnectionError):
                return
            with self._lock:
                if self._silent or self._loses_packet():
                    continue
                self._peer = peer
                if self._radio is None:
                    self._handle(data)
                else:
                    radio, number = self._radio
                    radio.put(number, "up", data, time.monotonic())

    def _handle(self, data: bytes) -> None:
        for answer in self.firmware.handle(data, time.monotonic()):
            self._send(answer)

    def pass_radio(self, way: str, data: bytes) -> None:
        """Take a packet from the modelled radio: one for the drone, or one of it."""
        with self._lock:
            if way == "up" and not self._silent:
                self._handle(data)
            elif way == "down":
                self._transmit(data)

    def tick(self) -> None:
        """Send log packets that are due."""
        with self._lock:
            due = self.firmware.tick(time.monotonic())
            if not self._silent and not self._mute:
                for packet in due:
                    self._send(packet)

    def _loses_packet(self) -> bool:
        return self.loss > 0.0 and bool(self._rng.random() < self.loss)

    def _send(self, data: bytes) -> None:
        if self._radio is None:
            self._transmit(data)
        else:
            radio, number = self._radio
            radio.put(number, "down", data, time.monotonic())

    def _transmit(self, data: bytes) -> None:
        if self._peer is not None and not self._loses_packet():
            with contextlib.suppress(BlockingIOError, ConnectionError):
                self.socket.sendto(data, self._peer)


class StandIns(ServedTeam[StandIn]):
    """Several stand-ins, served from `__enter__` to `__exit__`.

    Those with `auto_arm` are armed from the start, as Crazyflies 2.1 are shipped; those that fly by positions from
    `outside` believe to be at the origin without. Drones are spread among the modelled `radios` in turn.
    """

    def __init__(
        self,
        homes: Sequence[Position],
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        loss: float = 0.0,
        auto_arm: bool = False,
        controller: int = PID,
        missing: Collection[str] = (),
        seed: int = 0,
        outside: bool = False,
        radios: Sequence[ModelledRadio] = (),
    ) -> None:
        super().__init__(STEP_S)
        self._radios = radios
        rng = np.random.default_rng(seed)
        try:
            for k, home in enumerate(homes):
                body = PointMass(home=home, ground_m=home[2], auto_arm=auto_arm)
                firmware = Firmware(body, controller=controller, missing=missing, outside=outside)
                shared = (radios[k % len(radios)], k) if radios else None
                self._members.append(StandIn(host, port + k if port else 0, firmware, loss, rng, radio=shared))
        except OSError:
            self._close()
            raise

    def swap(self, one: int, two: int) -> None:
        """Let two drones take each other's position for their own, as a mix-up of their markers does."""
        (ax, ay, az), (bx, by, bz) = self[one].position, self[two].position
        self[one].jump((bx - ax, by - ay, bz - az))
        self[two].jump((ax - bx, ay - by, az - bz))

    def _between(self) -> None:
        for radio in self._radios:
            for drone, way, data in radio.step(time.monotonic()):
                self[drone].pass_radio(way, data)
