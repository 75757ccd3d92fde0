"""One link to one Crazyflie: the only place that knows cflib, its threads and its traps.

- cflib opens a link with callbacks and without a time limit: over UDP it resends nothing, so one lost packet blocks it
  for ever. Here packets are resent, and an attempt that stays silent for a while is given up.
- cflib's `close_link` first sends a set-point without thrust. In flight it would take the drone from its high-level
  commander and drop it, so it is not sent.
- cflib notices a dead radio link, but not a silent UDP one: `silent_s` does.
- cflib's calls may block (a radio's queue holds one packet): they run in threads, never on the event loop.
"""

from __future__ import annotations

import asyncio
import queue
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any, TypeVar

from llm_flock.errors import InputError
from llm_flock.robots.base import RobotError

SILENCE_S = 1.0
"""An attempt to open a link is given up after this silence [s]."""

PAUSE_S = 0.1
"""Between two attempts [s]."""

SEND_S = 2.5
"""Longest time to send one packet: cflib's radio driver gives up after 2 s [s]."""

HIGH_LEVEL_PORT = 8
SCHEMES = ("radio://", "udp://", "usb://", "tcp://", "serial://")

T = TypeVar("T")


def new_thread(work: Callable[[], None]) -> None:
    """Run something in a new thread, without waiting for it."""
    threading.Thread(target=work, name="crazyflie", daemon=True).start()


class Worker:
    """A thread that runs one job after another: starting a thread takes longer than sending a command."""

    def __init__(self) -> None:
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        new_thread(self._run)

    def do(self, job: Callable[[], None] | None) -> None:
        """Queue a job; None ends the thread."""
        self._jobs.put(job)

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            job()


async def in_thread(
    call: Callable[[], T], timeout_s: float, start: Callable[[Callable[[], None]], None] = new_thread
) -> T:
    """Run a blocking call in a thread that `start` provides, and wait for it with a time limit.

    Raises:
        TimeoutError: not done in time; the thread is abandoned.
    """
    future: Future[T] = Future()
    future.set_running_or_notify_cancel()  # so that giving up the wait leaves the call as it is

    def work() -> None:
        try:
            future.set_result(call())
        except Exception as error:  # noqa: BLE001  # raised where the result is awaited
            future.set_exception(error)

    start(work)
    return await asyncio.wait_for(asyncio.wrap_future(future), timeout_s)


def library() -> Any:
    """`cflib.crazyflie`, with its link drivers ready; raises InputError if it is not installed."""
    try:
        from cflib import crazyflie, crtp  # pyright: ignore[reportMissingTypeStubs]
    except ImportError as error:
        hint = "cflib, which is an extra: pip install 'llm-flock[crazyflie]'"
        raise InputError("drone", str(error), hint) from None
    drivers: Any = crtp
    if not drivers.CLASSES:
        drivers.init_drivers()
    return crazyflie


class CrazyflieLink:
    """One link, opened and closed once. Arguments as those of `CrazyflieRobot`."""

    def __init__(self, name: str, uri: str, cache: Path | None) -> None:
        self.lost: str | None = None
        self.quality: float | None = None
        self._name = name
        self._uri = uri
        self._cache = cache
        self._cf: Any = None
        self._heard_s = 0.0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._answers: dict[int, asyncio.Future[int]] = {}
        self._worker: Worker | None = None

    @property
    def open(self) -> bool:
        """Whether packets can be handed to it."""
        return self._cf is not None and self._cf.link is not None

    @property
    def cf(self) -> Any:
        """The `Crazyflie` of cflib.

        Raises:
            RobotError: the link is not open.
        """
        if not self.open:
            raise RobotError(self._name, self.why_closed)
        return self._cf

    @property
    def why_closed(self) -> str:
        """Why nothing can be sent, in words."""
        return f"the link is lost: {self.lost}" if self.lost else "is not connected"

    def silent_s(self, now: float) -> float:
        """Time since the last packet [s]."""
        return now - self._heard_s

    async def connect(self, timeout_s: float, parameters: Mapping[str, float]) -> None:
        """Open the link, fetch the tables, set the parameters; retry as long as time allows.

        Raises:
            InputError: cflib is not installed, or a parameter cannot be set.
            RobotError: not done within `timeout_s`.
        """
        library()
        self._loop = asyncio.get_running_loop()
        end = time.monotonic() + timeout_s
        attempts, why = 0, "no answer"
        while True:
            left = end - time.monotonic()
            if left <= 0.0:
                raise RobotError(
                    self._name, f"not connected to {self._uri} in {timeout_s:g} s ({attempts} times): {why}"
                )
            attempts += 1
            try:
                await self._attempt(end, bool(parameters))
                await self._set(parameters, end)
            except (TimeoutError, RobotError) as error:
                why = error.what if isinstance(error, RobotError) else "no answer"
                await self.close()
                await asyncio.sleep(min(PAUSE_S, max(0.0, end - time.monotonic())))
            except BaseException:
                await self.close()
                raise
            else:
                return

    async def _attempt(self, end: float, with_values: bool) -> None:
        """Try once to open the link, until `end`; raises RobotError or TimeoutError."""
        self.lost, self._heard_s = None, time.monotonic()
        cf = self._cf = library().Crazyflie(rw_cache=str(self._cache) if self._cache else None)
        cf.commander.send_setpoint = _nothing
        ready = asyncio.Event()

        def done(_uri: str) -> None:
            self._call(ready.set)

        (cf.fully_connected if with_values else cf.connected).add_callback(done)
        for caller in (cf.connection_failed, cf.connection_lost, cf.disconnected_link_error):
            caller.add_callback(self._lose)
        cf.packet_received.add_callback(self._hear)
        cf.link_statistics.link_quality_updated.add_callback(self._rate)
        cf.add_port_callback(HIGH_LEVEL_PORT, self._answered)
        await in_thread(lambda: cf.open_link(self._uri), end - time.monotonic())
        if self._uri.startswith("udp://") and cf.link is not None:
            cf.link.needs_resending = True
        while not ready.is_set():
            now = time.monotonic()
            if self.lost is not None:
                raise RobotError(self._name, self.lost)
            if now >= end or self.silent_s(now) > SILENCE_S:
                raise TimeoutError
            try:
                await asyncio.wait_for(ready.wait(), min(0.1, end - now))
            except TimeoutError:
                continue

    async def _set(self, parameters: Mapping[str, float], end: float) -> None:
        """Set parameters, until `end`; raises InputError or TimeoutError."""
        cf = self.cf
        for name, value in parameters.items():
            try:
                await in_thread(lambda n=name, v=value: cf.param.set_value(n, v), end - time.monotonic())
            except (KeyError, AttributeError) as error:
                raise InputError("parameters", name, f"those that {self._name} has and lets be set ({error})") from None

    async def log(
        self,
        name: str,
        period_ms: int,
        variables: Mapping[str, str],
        take: Callable[[Mapping[str, float], float], None],
    ) -> None:
        """Start a log block of variables, given by name with their types in packets.

        Its period is a multiple of 10 ms. `take` gets the values by name and their arrival [s], in cflib's thread.

        Raises:
            RobotError: the firmware does not know one of them.
        """

        def came(_stamp: int, data: dict[str, float], _block: object) -> None:
            take(data, time.monotonic())

        block = library().log.LogConfig(name, period_ms)
        for variable, kind in variables.items():
            block.add_variable(variable, kind)
        block.data_received_cb.add_callback(came)
        try:
            self.cf.log.add_config(block)
        except KeyError as error:
            raise RobotError(self._name, f"the firmware does not log {error}: update it") from None
        await in_thread(block.start, SEND_S)

    async def send(self, call: Callable[[Any], None], *, urgent: bool = False) -> None:
        """Send something with cflib's `Crazyflie`, in order; something urgent overtakes the queue.

        Raises:
            RobotError: the link is not open, or does not take the packet.
        """
        cf = self.cf
        worker = self._worker = self._worker or Worker()
        try:
            await in_thread(lambda: call(cf), SEND_S, new_thread if urgent else worker.do)
        except TimeoutError:
            self._end_worker()
            raise RobotError(self._name, "the link takes no packet") from None

    def _end_worker(self) -> None:
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.do(None)

    async def ask(self, command: int, call: Callable[[Any], None], timeout_s: float) -> int | None:
        """Send a command of the high-level commander; returns its answer (0 or an error), or None after a time-out."""
        answer: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        self._answers[command] = answer
        try:
            await self.send(call)
            return await asyncio.wait_for(answer, timeout_s)
        except TimeoutError:
            return None
        finally:
            self._answers.pop(command, None)

    async def close(self) -> None:
        """Close the link; the drone flies on."""
        self._end_worker()
        cf, self._cf = self._cf, None
        if cf is None:
            return

        def shut() -> None:
            # First, as this thread of cflib's sends through the link without checking it.
            cf.link_statistics.stop()
            cf.close_link()

        await in_thread(shut, 10.0)

    # The rest is called in cflib's threads.

    def _call(self, call: Callable[..., object], *arguments: object) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(call, *arguments)

    def _hear(self, _packet: object) -> None:
        self._heard_s = time.monotonic()

    def _lose(self, _uri: str, why: str) -> None:
        self.lost = self.lost or (why.strip().splitlines() or ["link error"])[0]

    def _rate(self, percent: float) -> None:
        self.quality = min(1.0, max(0.0, percent / 100.0))

    def _answered(self, packet: Any) -> None:
        data = bytes(packet.data)
        if len(data) >= 4:
            self._call(self._settle, data[0], data[3])

    def _settle(self, command: int, result: int) -> None:
        answer = self._answers.get(command)
        if answer is not None and not answer.done():
            answer.set_result(result)


def _nothing(*_: object) -> None:
    """Replaces a set-point without thrust."""
