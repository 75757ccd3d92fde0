"""A UDP socket that listens for vehicles, or calls one address."""

from __future__ import annotations

import asyncio
import errno
from collections.abc import Callable
from typing import Any

from llm_flock_flight._mavlink.address import VehicleAddress


class UdpLine(asyncio.DatagramProtocol):
    """An open socket; `on_data` gets each datagram and its sender."""

    def __init__(self, on_data: Callable[[bytes, Any], None]) -> None:
        self._on_data = on_data
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: Any) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self._on_data(data, addr)

    def error_received(self, exc: Exception) -> None:
        pass  # no program listens there: the missing heartbeats show it

    def send(self, packet: bytes, to: Any) -> None:
        if self._transport is not None and not self._transport.is_closing():
            self._transport.sendto(packet, to)

    def close(self) -> None:
        if self._transport is not None:
            self._transport.close()


async def open_udp(address: VehicleAddress, on_data: Callable[[bytes, Any], None]) -> UdpLine:
    """Open a UDP socket that listens at an address or calls it; OSError says why it cannot."""
    try:
        return await _open(address, on_data)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            message = "another program listens there, such as a ground station or a flight: end it, or use another port"
            raise OSError(error.errno, message) from error
        raise
    except ValueError as error:  # a host that cannot be one, by its letters or their number
        raise OSError(f"no host has the name {address.host!r}") from error


async def _open(address: VehicleAddress, on_data: Callable[[bytes, Any], None]) -> UdpLine:
    loop = asyncio.get_running_loop()
    endpoint = (address.host, address.port)
    if address.scheme == "udpin":
        _, line = await loop.create_datagram_endpoint(lambda: UdpLine(on_data), local_addr=endpoint)
    else:
        _, line = await loop.create_datagram_endpoint(lambda: UdpLine(on_data), remote_addr=endpoint)
    return line
