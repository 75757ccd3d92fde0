"""Commands to one autopilot and its answers: sent again until confirmed, refused with its reason, or given up."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from typing import Any

from llm_flock.robots import RobotError, TakenOver
from llm_flock_flight._mavlink.codec import result_name
from llm_flock_flight._mavlink.port import Port
from llm_flock_flight._mavlink.telemetry import VehicleTelemetry

ACCEPTED, TEMPORARILY, IN_PROGRESS = 0, 1, 5  # answers (MAV_RESULT)
ANSWER_S = 0.2  # wait for an answer before a command is sent again [s]

LOOK_S = 0.01


class CommandRefused(RobotError):
    """The autopilot refused a command."""


class Conversation:
    """Commands to the autopilot with `system_id` behind a port, one of a kind at a time.

    Once `taken` says why the autopilot is out of this program's hands, only an emergency stop is sent.
    """

    def __init__(self, name: str, port: Port, system_id: int) -> None:
        self.telemetry = VehicleTelemetry()
        self.name = name
        self.taken: str | None = None
        self._port = port
        self._system_id = system_id
        self._answers: dict[int, asyncio.Queue[int]] = {}

    def take(self, message: Any) -> None:
        """Take any message of the autopilot."""
        self.telemetry.take(message, time.monotonic())
        if message.get_type() == "COMMAND_ACK":
            waiting = self._answers.get(int(message.command))
            if waiting is not None:
                waiting.put_nowait(int(message.result))

    def send(self, kind: str, *fields: Any) -> None:
        """Send one message, without an answer."""
        self._port.send(self._system_id, kind, *fields)

    def tell(self, command: int, parameters: Sequence[float], confirmation: int = 0) -> None:
        """Send a command, without waiting for its answer."""
        rest = (0.0,) * (7 - len(parameters))
        self.send("command_long", self._system_id, 1, command, confirmation, *parameters, *rest)

    async def command(
        self,
        command: int,
        parameters: Sequence[float],
        what: str,
        timeout_s: float,
        done: Callable[[], bool] = lambda: False,
        *,
        anyway: bool = False,
    ) -> None:
        """Send a command, described by `what`, until the autopilot accepts it; raises TakenOver or another RobotError.

        `done` sees whether the autopilot has done it: its answer may have been lost, and it may refuse the same command
        again. A command sent `anyway` goes also to a vehicle that was taken over.
        """
        answers = self._answers[command] = asyncio.Queue()
        end = time.monotonic() + timeout_s
        last: int | None = None
        sent = 0
        try:
            while (left := end - time.monotonic()) > 0.0:
                if self.taken is not None and not anyway:
                    raise TakenOver(self.name, self.taken)
                self.tell(command, parameters, min(sent, 255))
                sent += 1
                answer = await self._answer(answers, min(ANSWER_S, left))
                while answer == IN_PROGRESS:
                    answer = await self._answer(answers, max(0.0, end - time.monotonic()))
                if answer == ACCEPTED or done():
                    return
                last = answer if answer is not None else last
                if answer == TEMPORARILY:
                    await asyncio.sleep(min(ANSWER_S, max(0.0, end - time.monotonic())))
                elif answer is not None:
                    break
        finally:
            if self._answers.get(command) is answers:
                del self._answers[command]
        if last is None:
            raise RobotError(self.name, f"did not answer to {what}, sent {sent} times in {timeout_s:g} s")
        if await self.until(done, 0.3):  # its text that says why comes after a refusal
            return
        raise CommandRefused(self.name, f"refused {what}: {result_name(last)}{self.telemetry.says(time.monotonic())}")

    async def _answer(self, answers: asyncio.Queue[int], timeout_s: float) -> int | None:
        try:
            async with asyncio.timeout(timeout_s):
                return await answers.get()
        except TimeoutError:
            return None

    async def parameters(self, names: Sequence[str], timeout_s: float) -> None:
        """Ask for parameters until all are there, or for `timeout_s`: one may not exist. Of "A|B", either will do."""
        end, known = time.monotonic() + timeout_s, self.telemetry.parameters

        def missing() -> list[str]:
            asked = [name.split("|") for name in names]
            return [one for either in asked if not any(one in known for one in either) for one in either]

        while time.monotonic() < end and missing():
            for name in missing():
                self.send("param_request_read", self._system_id, 1, name.encode(), -1)
            await self.until(lambda: not missing(), min(ANSWER_S, max(0.0, end - time.monotonic())))

    async def until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until the condition holds; returns whether it does within `timeout_s`."""
        end = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() >= end:
                return False
            await asyncio.sleep(LOOK_S)
        return True
