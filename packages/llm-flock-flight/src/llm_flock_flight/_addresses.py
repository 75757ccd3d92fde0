"""One spelling for each address of a drone, so that two ways of writing the same address are equal."""

from __future__ import annotations

import ipaddress
from collections.abc import Callable
from pathlib import Path

from llm_flock_flight._crazyflie.link import host_and_port
from llm_flock_flight._crazyflie.radios import address_of

NETWORK = {"udp": "udp", "udpin": "udp", "udpout": "udp", "tcp": "tcp"}
"""Schemes of a host and a port. Whoever listens at a port of this computer keeps others from being called there."""

HERE = "127.0.0.1"  # this computer


def one_spelling(uri: str, resolve: Callable[[str], str] = str) -> str:
    """An address without what does not tell drones apart: radio, data rate, options, the rate of a line, letters' case.

    `resolve` gives the address of a host that is a name. Raises ValueError for a radio's address that is none.
    """
    uri = uri.strip()
    radio = address_of(uri)
    if radio is not None:
        return f"radio {radio.channel} {radio.address}"
    scheme, place = uri.partition("://")[0].lower(), host_and_port(uri)
    if scheme in NETWORK and place is not None:
        return f"{NETWORK[scheme]} {_host(place[0], resolve)} {place[1]}"
    if scheme == "serial":
        return f"serial {_device(uri.partition('://')[2])}"
    return uri


def _host(host: str, resolve: Callable[[str], str]) -> str:
    host = host.rstrip(".").lower()
    address = _number(host) or _number(HERE if host == "localhost" else resolve(host))
    if address is None:
        return host
    mapped = getattr(address, "ipv4_mapped", None) or address
    return HERE if mapped.is_unspecified or mapped == ipaddress.ip_address("::1") else str(mapped)


def _number(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(text)
    except ValueError:
        return None


def _device(rest: str) -> str:
    """The device of a line, with links in /dev resolved."""
    path, _, rate = rest.rpartition(":")
    device = path if path and rate.isdecimal() else rest
    try:
        return str((Path("/dev") / device).resolve())
    except (OSError, RuntimeError, ValueError):  # links in a ring, letters that no path has
        return device
