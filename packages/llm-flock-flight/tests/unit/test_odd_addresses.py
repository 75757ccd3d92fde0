"""Addresses of every odd form are refused by name, and raise nothing else."""

from __future__ import annotations

import asyncio
import socket

import pytest

from llm_flock.errors import InputError
from llm_flock_flight._cli.stand_ins import stand_ins
from llm_flock_flight._crazyflie.radios import address_of
from llm_flock_flight._mavlink.address import parse_uri
from llm_flock_flight._mavlink.udp_line import open_udp
from llm_flock_flight._positions.udp import UdpPoses


@pytest.fixture
def no_host(monkeypatch: pytest.MonkeyPatch) -> None:
    """As for "a..b", or a name of more than 63 letters, on which a system is never asked."""

    def resolve(*_: object, **__: object) -> None:
        raise UnicodeError("label empty or too long")

    monkeypatch.setattr(socket, "getaddrinfo", resolve)


@pytest.mark.usefixtures("no_host")
def test_a_pose_host_that_can_be_none() -> None:
    with pytest.raises(InputError, match="pose_host"):
        asyncio.run(UdpPoses("a..b", 19700, ["cf1"]).open(lambda frame: None))


@pytest.mark.usefixtures("no_host")
@pytest.mark.parametrize("scheme", ["udp", "udpout"])
def test_a_vehicle_at_a_host_that_can_be_none(scheme: str) -> None:
    with pytest.raises(OSError, match="no host has the name"):
        asyncio.run(open_udp(parse_uri(f"{scheme}://a..b:14540"), lambda data, peer: None))


@pytest.mark.parametrize(
    "uri", ["serial:///dev/a:0", f"serial:///dev/a:{'9' * 5000}", "serial:///dev/a\0b:57600", "serial:/dev/a"]
)
def test_serial_lines_that_can_be_none(uri: str) -> None:
    with pytest.raises(InputError, match="expected"):
        parse_uri(uri)


def test_a_rate_in_other_digits_belongs_to_the_path() -> None:
    assert parse_uri("serial:///dev/a:\u00b2").host == "/dev/a:\u00b2"


@pytest.mark.parametrize(
    "uri",
    [
        "radio://0/0000999/2M/E7E7E7E701",
        "radio://[/80/2M",
        "RADIO://0/80/2M/E7E7E7E701",
        "radio:0/80/2M/E7E7E7E701",
        " radio://0/80/2M/E7E7E7E701",
        "radio://0/80/2M/E7E7E7E701 ",
        "radio://0\n/80/2M/E7E7E7E701",
    ],
)
def test_radios_that_cflib_would_not_take(uri: str) -> None:
    with pytest.raises(ValueError, match="radio://0/80/2M"):
        address_of(uri)


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"count": 2, "port": 65535}, "port"),
        ({"count": 2, "port": 65535, "mavlink": "px4"}, "port"),
        ({"count": 300, "mavlink": "px4"}, "count"),
        ({"count": 2, "spacing": float("inf")}, "spacing"),
    ],
)
def test_stand_ins_that_cannot_be_served(options: dict[str, object], field: str) -> None:
    with pytest.raises(InputError) as error:
        stand_ins(**options, seconds=0.0)  # type: ignore[arg-type]
    assert error.value.field == field
