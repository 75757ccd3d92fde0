"""Addresses of vehicles: connection URIs of UDP ports and serial lines."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import urlsplit

from llm_flock.errors import InputError

SCHEMES = ("udp", "udpin", "udpout", "serial")
ADDRESSES = "udp://0.0.0.0:14540 to listen, udpout://HOST:PORT to call, or serial:///dev/ttyACM0:57600"

MAX_BAUD = 20_000_000  # highest accepted rate of a serial line [baud]


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
