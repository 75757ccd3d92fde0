"""Reads and writes single firmware parameters, packet by packet.

cflib reads all of a drone's parameters, some three hundred, before it lets one be set, and its thread for that dies
where an answer comes twice. A flight needs a dozen. Packets: `src/modules/src/param_logic.c` of the firmware, protocol
versions from 4 on.
"""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import Awaitable, Callable, Iterable, Mapping
from typing import Any, TypeAlias

from llm_flock.errors import InputError
from llm_flock.robots import RobotError

PORT, READ, WRITE = 2, 1, 2  # port of parameters, and the channels on which they are read and written
ANSWER_S = 0.25  # wait for an answer before a packet is sent again [s]

RESET_THEMSELVES = ("kalman.resetEstimation", "kalmanUKF.resetEstimation")
"""Parameters that the firmware sets back to 0 as soon as it has acted on them."""

Send: TypeAlias = Callable[[int, int, bytes], Awaitable[None]]  # sends a packet: its port, its channel and its data


class FirmwareParameters:
    """The parameters of one drone, over an open link. `hear` gets every packet of `PORT`, in the event loop."""

    def __init__(self, name: str, table: Any, send: Send) -> None:
        self._name = name
        self._table = table
        self._send = send
        self._waiting: dict[tuple[int, int], asyncio.Future[bytes]] = {}

    def hear(self, channel: int, data: bytes) -> None:
        if len(data) >= 2 and channel in (READ, WRITE):
            waiting = self._waiting.get((channel, struct.unpack_from("<H", data)[0]))
            if waiting is not None and not waiting.done():
                waiting.set_result(data[2:])

    def known(self, names: Iterable[str]) -> list[str]:
        """The names that the firmware knows."""
        return [name for name in names if self._element(name) is not None]

    def _element(self, name: str) -> Any:
        group, _, own = name.partition(".")
        return self._table.get_element(group, own)

    async def read(self, name: str, until_s: float) -> float:
        """The value of a parameter that the firmware has; RobotError if none comes until then."""
        element = self._element(name)
        data = await self._ask(READ, element.ident, b"", name, until_s)
        return float(struct.unpack(element.pytype, data[1:])[0])

    async def write(self, values: Mapping[str, float], until_s: float) -> tuple[str, ...]:
        """Set parameters or raise, and read each back; returns those that have another value, as text."""
        differ: list[str] = []
        for name, value in values.items():
            element = self._element(name)
            if element is None or element.get_readable_access() == "RO":
                why = "it has none of this name" if element is None else "it is read-only"
                raise InputError("parameters", name, f"those that {self._name} has and lets be set ({why})")
            code: str = element.pytype
            try:
                packed = struct.pack(code, value if code in ("<f", "<d", "<e") else int(value))
            except struct.error:
                raise InputError("parameters", f"{name} = {value:g}", f"a value of its type ({code[1:]})") from None
            await self._ask(WRITE, element.ident, packed, name, until_s)
            wanted, found = float(struct.unpack(code, packed)[0]), await self.read(name, until_s)
            if found != wanted and name not in RESET_THEMSELVES:
                differ.append(f"{name} is {found:g}, though it was set to {wanted:g}")
        return tuple(differ)

    async def _ask(self, channel: int, number: int, value: bytes, name: str, until_s: float) -> bytes:
        answer: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
        self._waiting[channel, number] = answer
        try:
            while time.monotonic() < until_s:
                await self._send(PORT, channel, struct.pack("<H", number) + value)
                await asyncio.wait((answer,), timeout=ANSWER_S)
                if answer.done():
                    return answer.result()
        finally:
            self._waiting.pop((channel, number), None)
        raise RobotError(self._name, f"does not answer for its parameter {name}")
