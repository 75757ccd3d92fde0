"""Encodes and decodes MAVLink: the only place that knows pymavlink. Input may be anything, and never raises."""

from __future__ import annotations

import struct
from importlib import import_module
from typing import Any

from llm_flock.extras import require
from llm_flock.printable import one_line

GROUND_STATION = 255  # system id whose heartbeats ArduPilot's failsafe awaits, unless told otherwise
COMPONENT = 190  # component id of ground station software (MAV_COMP_ID_MISSIONPLANNER)
AUTOPILOT = 1  # component id of an autopilot (MAV_COMP_ID_AUTOPILOT1)
MAX_BYTES = 4096  # most bytes that are parsed at once
HEARTBEAT = 0  # message id
INTEGERS = {1: "<B3x", 2: "<b3x", 3: "<H2x", 4: "<h2x", 5: "<I", 6: "<i"}  # by MAV_PARAM_TYPE, as PX4 packs them


def dialect() -> Any:
    """Pymavlink's messages, or InputError: those of MAVLink's common set, and ArduPilot's."""
    require("mavlink", "a vehicle that speaks MAVLink")
    return import_module("pymavlink.dialects.v20.ardupilotmega")


def introduces(data: bytes) -> bool:
    """Whether there is a heartbeat among the packets of a datagram, by their headers: cheap, and nothing is checked."""
    at, size = 0, min(len(data), MAX_BYTES)
    while at + 6 <= size:
        if data[at] == 0xFD and at + 10 <= size:
            number, length = int.from_bytes(data[at + 7 : at + 10], "little"), 12 + 13 * (data[at + 2] & 1)
        elif data[at] == 0xFE:
            number, length = data[at + 5], 8
        else:
            return False
        if number == HEARTBEAT:
            return True
        at += length + data[at + 1]
    return False


class Codec:
    """Writes packets of one sender, and reads packets of all senders."""

    def __init__(self, system_id: int = GROUND_STATION, component: int = COMPONENT) -> None:
        self._dialect = dialect()
        self._system_id, self._component = system_id, component
        self._writer: Any = self._dialect.MAVLink(None, srcSystem=system_id, srcComponent=component)
        self._reader: Any = None

    def encode(self, kind: str, *fields: Any) -> bytes:
        """A packet: name of its message in small letters, and its fields in the order of the definition."""
        message = getattr(self._writer, f"{kind}_encode")(*fields)
        packet: bytes = message.pack(self._writer)
        self._writer.seq = (self._writer.seq + 1) % 256
        return packet

    def datagram(self, data: bytes) -> list[Any]:
        """The messages of a datagram; bytes that are none are dropped, and spoil no other datagram."""
        return self._read(self._new_reader(), data)

    def stream(self, data: bytes) -> list[Any]:
        """The messages that more bytes of a serial line complete."""
        if self._reader is None:
            self._reader = self._new_reader()
        return self._read(self._reader, data)

    def _new_reader(self) -> Any:
        reader: Any = self._dialect.MAVLink(None)
        reader.robust_parsing = True
        return reader

    def _read(self, reader: Any, data: bytes) -> list[Any]:
        try:
            found: list[Any] = reader.parse_buffer(data[:MAX_BYTES]) or []
            return [message for message in found if message.get_type() != "BAD_DATA"]
        except Exception:  # noqa: BLE001  # the library raises several kinds, and bytes of a stranger end no flight
            self._reader = None
            return []


def result_name(result: int) -> str:
    """An autopilot's answer to a command (MAV_RESULT) as text."""
    names = {
        0: "accepted",
        1: "temporarily rejected",
        2: "denied",
        3: "unsupported",
        4: "failed",
        5: "in progress",
        6: "cancelled",
        7: "takes no COMMAND_LONG",
        8: "takes only COMMAND_INT",
        9: "does not know this frame",
    }
    return names.get(result, f"answer {result}")


def text_of(value: object) -> str:
    """Text of a message in one line that is safe to show."""
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
    return one_line(text.split("\0")[0].strip(), 120)


def parameter_value(message: Any, integers_as_bits: bool) -> float:
    """The value of a PARAM_VALUE: PX4 sends an integer's bits in the float, ArduPilot its value."""
    layout = INTEGERS.get(int(message.param_type))
    value = float(message.param_value)
    if layout is None or not integers_as_bits:
        return value
    return float(struct.unpack(layout, struct.pack("<f", value))[0])
