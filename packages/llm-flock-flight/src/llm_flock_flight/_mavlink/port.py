"""Ports: one UDP socket or serial line, the vehicles behind it by their system ids, and our heartbeats to them.

A port opens with its first vehicle and closes with its last. Nothing here outlives the event loop: when this process
hangs or dies, heartbeats and set-points stop together, and the autopilots' own failsafes begin.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

from llm_flock_flight._mavlink.address import parse_uri
from llm_flock_flight._mavlink.codec import AUTOPILOT, GROUND_STATION, Codec, introduces
from llm_flock_flight._mavlink.udp_line import UdpLine, open_udp

if TYPE_CHECKING:
    from llm_flock_flight._mavlink.serial_line import SerialLine

    Line: TypeAlias = "UdpLine | SerialLine"

STRANGERS = 200  # most heartbeats of unknown senders that are parsed in a second: they may be new vehicles
HEARTBEAT_S = 0.5  # time between two of our heartbeats [s]
PEER_TIMEOUT_S = 3.0  # after this silence a vehicle may answer from another address [s]

MAV_TYPE_GCS, MAV_AUTOPILOT_INVALID, MAV_STATE_ACTIVE = 6, 8, 4


class RateLimit:
    """Allows a number of calls in each second of the clock."""

    def __init__(self, limit: int) -> None:
        self._limit, self._second, self._count = limit, 0, 0

    def allows(self, now: float) -> bool:
        if int(now) != self._second:
            self._second, self._count = int(now), 0
        self._count += 1
        return self._count <= self._limit


class Port:
    """The vehicles at one address. `attach` and `detach` open and close it."""

    def __init__(self, uri: str) -> None:
        self.uri = uri
        self.heard_ids: set[int] = set()
        self.duplicate_ids: set[int] = set()
        self._address = parse_uri(uri)
        self._vehicles: dict[int, Callable[[Any], None]] = {}
        self._peers: dict[int, tuple[Any, float]] = {}
        self._strangers = RateLimit(STRANGERS)
        self._codec: Codec | None = None
        self._line: Line | None = None
        self._opening = asyncio.Lock()
        self._heartbeats: asyncio.Task[None] | None = None

    async def attach(self, system_id: int, take: Callable[[Any], None]) -> None:
        """Hand the messages of one autopilot to `take`, until `detach`; InputError or OSError if it cannot open."""
        if system_id in self._vehicles:
            raise OSError(f"system id {system_id} is in use there")
        async with self._opening:
            if self._line is None:
                self._codec = Codec()
                await asyncio.sleep(0.0)  # a socket of ours that was just closed is free in the loop's next turn
                self._line = await self._open(self._codec)
                self._heartbeats = asyncio.create_task(self._send_heartbeats())
            self._vehicles[system_id] = take

    async def _open(self, codec: Codec) -> Line:
        address = self._address
        if address.scheme == "serial":
            from llm_flock_flight._mavlink.serial_line import open_serial

            loop = asyncio.get_running_loop()

            def on_data(data: bytes) -> None:
                loop.call_soon_threadsafe(lambda: self._on_messages(codec.stream(data), None))

            return await asyncio.to_thread(open_serial, address.host, address.port, on_data)
        return await open_udp(address, functools.partial(self._on_datagram, codec))

    def _on_datagram(self, codec: Codec, data: bytes, peer: Any) -> None:
        """From an unknown sender, parse only heartbeats, and at most STRANGERS a second."""
        stranger = all(peer != known for known, _ in self._peers.values())
        if stranger and not (introduces(data) and self._strangers.allows(time.monotonic())):
            return
        self._on_messages(codec.datagram(data), peer)

    def detach(self, system_id: int) -> None:
        """Stop; the last vehicle closes the port."""
        self._vehicles.pop(system_id, None)
        self._peers.pop(system_id, None)
        self.duplicate_ids.discard(system_id)
        if not self._vehicles and self._line is not None:
            line, self._line = self._line, None
            if self._heartbeats is not None:
                self._heartbeats.cancel()
            line.close()
            self._peers.clear()
            self.heard_ids.clear()

    def attached(self, system_id: int) -> bool:
        """Whether a vehicle is on the port now."""
        return self._line is not None and system_id in self._vehicles

    def send(self, system_id: int, kind: str, *fields: Any) -> None:
        """Send a message to a vehicle. When listening (`udpin`), does nothing until the vehicle has been heard."""
        if self._line is None or self._codec is None:
            return
        listens = self._address.scheme == "udpin"
        peer, _ = self._peers.get(system_id, (None, 0.0))
        if listens and peer is None:
            return
        packet = self._codec.encode(kind, *fields)
        with contextlib.suppress(OSError):
            self._line.send(packet, peer if listens else None)

    async def _send_heartbeats(self) -> None:
        while True:
            for system_id in [*self._vehicles] if self._address.scheme == "udpin" else [0]:
                self.send(system_id, "heartbeat", MAV_TYPE_GCS, MAV_AUTOPILOT_INVALID, 0, 0, MAV_STATE_ACTIVE)
            await asyncio.sleep(HEARTBEAT_S)

    def _on_messages(self, messages: list[Any], peer: Any) -> None:
        now = time.monotonic()
        for message in messages:
            system_id = int(message.get_srcSystem())
            if system_id in (0, GROUND_STATION) or int(message.get_srcComponent()) != AUTOPILOT:
                continue  # a ground station, a gimbal, a camera
            known, seen = self._peers.get(system_id, (None, 0.0))
            if known is not None and peer != known and now - seen < PEER_TIMEOUT_S:
                self.duplicate_ids.add(system_id)
                continue
            if message.get_type() != "HEARTBEAT" and known != peer:
                continue  # a vehicle introduces itself by its heartbeat
            self.heard_ids.add(system_id)
            take = self._vehicles.get(system_id)
            if take is not None:  # other senders stay strangers, and little of theirs is parsed
                self._peers[system_id] = (peer, now)
                take(message)


class Ports(dict[str, Port]):
    """The ports of a fleet by their URIs, not opened yet: robots with the same URI share one."""

    def __missing__(self, uri: str) -> Port:
        self[uri] = Port(uri)
        return self[uri]
