"""The load and the capacity of each Crazyradio: a pure function of the drones' addresses and their traffic.

The unit is the exchange: the radio sends one packet to one drone, and the acknowledgement brings back at most one.
cflib 0.1.34 hands a packet to the radio over USB and reads the answer before the next one, and sets address, channel
and data rate by USB requests of their own whenever they differ from those of the packet before. Times of both:

- an exchange at 2 Mbit/s, two USB transfers: about 0.7 ms (measured by a user: bitcraze/crazyradio2-firmware, issue 9);
- one such request: about 1 ms (Bitcraze's wiki, "Usb and Radio protocol of the Crazyradio dongle").

So a radio with several drones on one channel does about 590 exchanges a second, and on several channels 370. Bitcraze's
own numbers are similar: at least 500 a second (bitcraze/crazyflie-lib-python, issue 258), "400ish" (issue
467). The user above counted 300, with another library. It is a model for planning: measure your radios.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from types import MappingProxyType
from urllib.parse import urlsplit

EXCHANGE_S = 0.0007  # time of an exchange at 2 Mbit/s without changes of settings [s]
SETTING_S = 0.001  # time to set address, channel or data rate before it [s]
BITS_PER_S: Mapping[str, float] = MappingProxyType({"250K": 250e3, "1M": 1e6, "2M": 2e6})  # data rates in addresses

MAX_PACKET_BITS = 2 * 8 * 41
"""In the air for the longest packet and the longest answer: 32 bytes, and 9 around them, each."""

MAX_SHARE = 0.7
"""Share of a radio's exchanges that may be planned for: the rest is for resending, and for commands to all at once."""

POSITION_HZ, VARIANCE_HZ, LIGHTHOUSE_HZ, PING_HZ = 20.0, 10.0, 2.0, 10.0
"""Packets of each drone a second: log blocks, and cflib's own pings with their echoes, which measure latency."""

WIFI_MHZ: Mapping[int, int] = MappingProxyType({1: 2412, 6: 2437, 11: 2462})
"""Centres of the Wi-Fi channels that are used most."""

WIFI_HALF_MHZ, RADIO_HALF_MHZ = 11, 1
"""Half of the width of a Wi-Fi channel of 20 MHz with its edges, and of a Crazyradio channel at 2 Mbit/s."""

LAST_IN_BAND = 83  # channels beyond are above 2.4835 GHz, where few countries allow sending without a licence

LAST_CHANNEL = 125


@dataclass(frozen=True, slots=True)
class RadioAddress:
    """A drone's radio address: `radio://DONGLE/CHANNEL/RATE/ADDRESS`."""

    dongle: str
    channel: int
    rate: str
    address: str


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioLoad:
    """The load of one radio: exchanges that its drones need, and that it can do by the model [1/s]."""

    dongle: str
    drones: tuple[str, ...]
    channels: tuple[int, ...]
    needed_hz: float
    capacity_hz: float

    @property
    def share(self) -> float:
        """Share of the capacity that is needed; more than 1 is impossible."""
        return self.needed_hz / self.capacity_hz

    @property
    def turn_s(self) -> float:
        """Time from one turn of a drone to its next when all are served in turn: so long a packet may wait [s]."""
        return len(self.drones) / self.capacity_hz

    def __str__(self) -> str:
        channels = ", ".join(map(str, self.channels))
        return (
            f"{len(self.drones)} drones on channel {channels}: {self.needed_hz:.0f} of {self.capacity_hz:.0f} exchanges"
            f" a second ({self.share:.0%}), each drone every {1000 * self.turn_s:.0f} ms"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioPlan:
    """The loads of all radios, what is wrong (the flight is refused), and what is to be warned of."""

    loads: tuple[RadioLoad, ...]
    faults: tuple[str, ...]
    warnings: tuple[str, ...]


def address_of(uri: str) -> RadioAddress | None:
    """The parts of a radio's URI, with cflib's defaults; None for other links. ValueError says what is expected."""
    try:
        parts = urlsplit(uri)
    except ValueError:
        raise ValueError("radio://DONGLE/CHANNEL/RATE/ADDRESS: radio://0/80/2M/E7E7E7E701") from None
    if parts.scheme != "radio":
        return None
    if not uri.startswith("radio://") or any(c.isspace() for c in uri):  # cflib would not take it for a radio's
        raise ValueError("radio://DONGLE/CHANNEL/RATE/ADDRESS without spaces: radio://0/80/2M/E7E7E7E701")
    path = [part for part in parts.path.split("/") if part]
    channel, rate, address = (*path, *("2", "2M", "E7E7E7E7E7")[len(path) :])[:3]
    if (
        not (channel.isascii() and channel.isdecimal() and len(channel) <= 4 and int(channel) <= LAST_CHANNEL)
        or len(path) > 3
    ):
        raise ValueError(f"a channel from 0 to {LAST_CHANNEL}: radio://0/80/2M/E7E7E7E701")
    if rate not in BITS_PER_S:
        raise ValueError(f"a data rate of {', '.join(BITS_PER_S)}: radio://0/80/2M/E7E7E7E701")
    address = address.upper().rjust(10, "0")
    if len(address) != 10 or not set(address) <= set("0123456789ABCDEF"):
        raise ValueError("an address of ten hexadecimal digits: radio://0/80/2M/E7E7E7E701")
    return RadioAddress(parts.netloc.upper(), int(channel), rate, address)


def exchanges_of(*, round_s: float, pose_hz: float = 0.0) -> float:
    """Exchanges of a drone [1/s], each of one packet up and one down, with this many poses from outside a second."""
    commands_hz = 1.2 / round_s  # some are sent again
    up_hz = pose_hz + PING_HZ + commands_hz
    return max(up_hz, POSITION_HZ + VARIANCE_HZ + LIGHTHOUSE_HZ + PING_HZ + commands_hz)


def capacity_hz(addresses: Sequence[RadioAddress]) -> float:
    """Exchanges a second of one radio that serves these drones in turn, by the model of this module [1/s]."""
    changes = sum(len({getattr(found, part) for found in addresses}) > 1 for part in ("address", "channel", "rate"))
    slower = sum(1.0 / BITS_PER_S[found.rate] - 1.0 / BITS_PER_S["2M"] for found in addresses) / len(addresses)
    return 1.0 / (EXCHANGE_S + MAX_PACKET_BITS * slower + SETTING_S * changes)


def plan_radios(drones: Sequence[tuple[str, str]], each_hz: float) -> RadioPlan:
    """The load of each radio, and the faults, for drones by name and URI with this many exchanges each [1/s]."""
    found: dict[str, RadioAddress] = {}
    faults: list[str] = []
    for name, uri in drones:
        try:
            address = address_of(uri)
        except ValueError as error:
            faults.append(f"{name}: {uri}: expected {error}")
            continue
        if address is not None:
            found[name] = address
    for (one, a), (two, b) in combinations(found.items(), 2):
        if (a.channel, a.address) == (b.channel, b.address):
            faults.append(f"{one} and {two}: both have the address {a.address} on channel {a.channel}")
    served: dict[str, dict[str, RadioAddress]] = defaultdict(dict)
    for name, address in found.items():
        served[address.dongle][name] = address
    loads = tuple(_load(dongle, served[dongle], each_hz) for dongle in sorted(served))
    return RadioPlan(loads=loads, faults=tuple(faults), warnings=tuple(_warnings(loads, each_hz)))


def _load(dongle: str, served: Mapping[str, RadioAddress], each_hz: float) -> RadioLoad:
    return RadioLoad(
        dongle=dongle,
        drones=tuple(served),
        channels=tuple(sorted({address.channel for address in served.values()})),
        needed_hz=len(served) * each_hz,
        capacity_hz=capacity_hz(list(served.values())),
    )


def _warnings(loads: Sequence[RadioLoad], each_hz: float) -> list[str]:
    notes: list[str] = []
    for load in loads:
        if load.share > MAX_SHARE:
            drones = sum(len(other.drones) for other in loads)
            enough = radios_for(drones, each_hz)
            advice = f"; {enough} radios would carry {drones} drones" if enough > len(loads) else ""
            notes.append(
                f"radio {load.dongle} needs {load.share:.0%} of what it can do (at most {MAX_SHARE:.0%}){advice}"
            )
        if len(load.channels) > 1:
            notes.append(
                f"radio {load.dongle} serves channels {', '.join(map(str, load.channels))}: it retunes for each packet,"
                f" which costs about {1000 * SETTING_S:g} ms; give all its drones one channel"
            )
        for channel in load.channels:
            if (wifi := wifi_over(channel)) is not None:
                notes.append(
                    f"channel {channel} lies in Wi-Fi channel {wifi}; those from 75 to {LAST_IN_BAND} lie in none"
                )
            if channel > LAST_IN_BAND:
                notes.append(f"channel {channel} is above 2.4835 GHz, where sending needs a licence in most countries")
    for one, two in combinations(loads, 2):
        near = [(a, b) for a in one.channels for b in two.channels if abs(a - b) < 2 * RADIO_HALF_MHZ]
        for a, b in near:
            notes.append(
                f"radios {one.dongle} and {two.dongle} share the air of channels {a} and {b}: leave 2 between them"
            )
    return notes


def wifi_over(channel: int) -> int | None:
    """The Wi-Fi channel of 1, 6 and 11 that a radio's channel overlaps; None if it overlaps none of them."""
    for wifi, middle in WIFI_MHZ.items():
        if abs(2400 + channel - middle) < WIFI_HALF_MHZ + RADIO_HALF_MHZ:
            return wifi
    return None


def radios_for(n_drones: int, each_hz: float) -> int:
    """The smallest number of radios that carries this number of drones, each radio on one channel at 2 Mbit/s."""
    each = math.floor(MAX_SHARE / (EXCHANGE_S + SETTING_S) / each_hz)
    return math.ceil(n_drones / max(1, each))


def proposed_uris(n_drones: int, n_radios: int) -> list[str]:
    """URIs, or ValueError: one channel a radio, beside Wi-Fi and 2 MHz apart; one address a drone."""
    channels = [c for c in range(LAST_IN_BAND, -1, -2) if wifi_over(c) is None]
    if not 1 <= n_radios <= len(channels):
        raise ValueError(f"1 to {len(channels)} radios")
    if not 1 <= n_drones <= 0xFF:
        raise ValueError("1 to 255 drones")
    return [f"radio://{k % n_radios}/{channels[k % n_radios]}/2M/E7E7E7E7{k + 1:02X}" for k in range(n_drones)]
