"""Ports: one UDP socket or serial line, the vehicles behind it by their system ids, and our heartbeats to them.

A port opens with its first vehicle and closes with its last. Nothing here outlives the event loop: when this process
hangs or dies, heartbeats and set-points stop together, and the autopilots' own failsafes begin.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import functools
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias
from urllib.parse import urlsplit

from llm_flock.errors import InputError
from llm_flock_flight._mavlink.codec import AUTOPILOT, GROUND_STATION, Codec, introduces

if TYPE_CHECKING:
    from llm_flock_flight._mavlink.serial_line import SerialLine

    Line: TypeAlias = "_Udp | SerialLine"

SCHEMES = ("udp", "udpin", "udpout", "serial")
ADDRESSES = "udp://0.0.0.0:14540 to listen, udpout://HOST:PORT to call, or serial:///dev/ttyACM0:57600"

STRANGERS = 200
"""Most datagrams of unknown senders that are parsed in a second: they may be vehicles that introduce themselves."""


MAX_BAUD = 20_000_000
"""Highest rate of a serial line that is believed [baud]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleAddress:
    """A connection URI in parts; `port` is a UDP port, or the rate of a serial line [baud]."""

    scheme: str
    host: str
    port: int


def parse_uri(uri: str) -> VehicleAddress:
    """The parts of a connection URI, or InputError."""
    try:
        parts = urlsplit(uri)
        scheme, host, port = parts.scheme, parts.hostname or "", parts.port
    except ValueError:
        scheme, host, port = uri.partition("://")[0], "", None
    if scheme == "serial" and uri.startswith("serial://") and "\0" not in uri:
        path, _, rate = uri.removeprefix("serial://").rpartition(":")
        if not (rate.isascii() and rate.isdigit()):
            path, rate = uri.removeprefix("serial://"), "57600"
        if path and len(rate) <= len(str(MAX_BAUD)) and 0 < int(rate) <= MAX_BAUD:
            return VehicleAddress(scheme=scheme, host=path, port=int(rate))
    elif scheme in SCHEMES and host and port:
        return VehicleAddress(scheme="udpin" if scheme == "udp" else scheme, host=host, port=port)
    raise InputError("uri", uri, ADDRESSES)


class Port:
    """The vehicles at one address. `attach` and `detach` open and close it."""

    def __init__(self, uri: str) -> None:
        self.uri = uri
        self.heard: set[int] = set()
        self.twice: set[int] = set()
        self._address = parse_uri(uri)
        self._vehicles: dict[int, Callable[[Any], None]] = {}
        self._peers: dict[int, tuple[Any, float]] = {}
        self._strangers = (0, 0)  # a second, and the datagrams of unknown senders that were parsed in it
        self._codec: Codec | None = None
        self._line: Line | None = None
        self._opening = asyncio.Lock()
        self._beating: asyncio.Task[None] | None = None

    async def attach(self, system_id: int, take: Callable[[Any], None]) -> None:
        """Hand the messages of one autopilot to `take`, until `detach`; InputError or OSError if it cannot open."""
        if system_id in self._vehicles:
            raise OSError(f"system id {system_id} is in use there")
        async with self._opening:
            if self._line is None:
                self._codec = Codec()
                await asyncio.sleep(0.0)  # a socket of ours that was just closed is free in the loop's next turn
                self._line = await self._open(self._codec)
                self._beating = asyncio.create_task(self._send_heartbeats())
            self._vehicles[system_id] = take

    async def _open(self, codec: Codec) -> Line:
        address = self._address
        if address.scheme == "serial":
            from llm_flock_flight._mavlink.serial_line import open_serial

            loop = asyncio.get_running_loop()

            def came(data: bytes) -> None:
                loop.call_soon_threadsafe(lambda: self._came(codec.stream(data), None))

            return await asyncio.to_thread(open_serial, address.host, address.port, came)
        return await open_udp(address, functools.partial(self._datagram, codec))

    def _datagram(self, codec: Codec, data: bytes, peer: Any) -> None:
        """Take a datagram; only a heartbeat of an unknown sender is worth the time to parse it, and not any number."""
        if all(peer != known for known, _ in self._peers.values()):
            if not introduces(data):
                return
            second, parsed = self._strangers
            parsed = parsed + 1 if int(time.monotonic()) == second else 1
            if parsed > STRANGERS:
                return
            self._strangers = int(time.monotonic()), parsed
        self._came(codec.datagram(data), peer)

    def detach(self, system_id: int) -> None:
        """Stop; the last vehicle closes the port."""
        self._vehicles.pop(system_id, None)
        self._peers.pop(system_id, None)
        self.twice.discard(system_id)
        if not self._vehicles and self._line is not None:
            line, self._line = self._line, None
            if self._beating is not None:
                self._beating.cancel()
            line.close()
            self._peers.clear()
            self.heard.clear()

    def attached(self, system_id: int) -> bool:
        """Whether a vehicle is on the port now."""
        return self._line is not None and system_id in self._vehicles

    def send(self, system_id: int, kind: str, *fields: Any) -> None:
        """Send one message towards a vehicle; without effect until it has been heard, unless the address calls it."""
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
        # GCS, no autopilot, active (MAV_TYPE_GCS, MAV_AUTOPILOT_INVALID, MAV_STATE_ACTIVE).
        while True:
            for system_id in [*self._vehicles] if self._address.scheme == "udpin" else [0]:
                self.send(system_id, "heartbeat", 6, 8, 0, 0, 4)
            await asyncio.sleep(0.5)

    def _came(self, messages: list[Any], peer: Any) -> None:
        now = time.monotonic()
        for message in messages:
            system_id = int(message.get_srcSystem())
            if system_id in (0, GROUND_STATION) or int(message.get_srcComponent()) != AUTOPILOT:
                continue  # a ground station, a gimbal, a camera
            known, seen = self._peers.get(system_id, (None, 0.0))
            if known is not None and peer != known and now - seen < 3.0:  # later it may answer from there
                self.twice.add(system_id)
                continue
            if message.get_type() != "HEARTBEAT" and known != peer:
                continue  # a vehicle introduces itself by its heartbeat
            self.heard.add(system_id)
            self._peers[system_id] = (peer, now)
            take = self._vehicles.get(system_id)
            if take is not None:
                take(message)


class Ports(dict[str, Port]):
    """The ports of a fleet by their URIs, not opened yet: robots with the same URI share one."""

    def __missing__(self, uri: str) -> Port:
        self[uri] = Port(uri)
        return self[uri]


class _Udp(asyncio.DatagramProtocol):
    def __init__(self, came: Callable[[bytes, Any], None]) -> None:
        self._came = came
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: Any) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self._came(data, addr)

    def error_received(self, exc: Exception) -> None:
        pass  # nobody listens there yet, or not any more: silence tells

    def send(self, packet: bytes, to: Any) -> None:
        if self._transport is not None and not self._transport.is_closing():
            self._transport.sendto(packet, to)

    def close(self) -> None:
        if self._transport is not None:
            self._transport.close()


async def open_udp(address: VehicleAddress, came: Callable[[bytes, Any], None]) -> Line:
    """A UDP socket, listening or calling one address; OSError says why not."""
    try:
        return await _endpoint(address, came)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            says = "another program listens there, such as a ground station or a flight: end it, or use another port"
            raise OSError(error.errno, says) from error
        raise
    except ValueError as error:  # a host that cannot be one, by its letters or their number
        raise OSError(f"no host has the name {address.host!r}") from error


async def _endpoint(address: VehicleAddress, came: Callable[[bytes, Any], None]) -> Line:
    loop = asyncio.get_running_loop()
    place = (address.host, address.port)
    if address.scheme == "udpin":
        _, line = await loop.create_datagram_endpoint(lambda: _Udp(came), local_addr=place)
    else:
        _, line = await loop.create_datagram_endpoint(lambda: _Udp(came), remote_addr=place)
    return line
