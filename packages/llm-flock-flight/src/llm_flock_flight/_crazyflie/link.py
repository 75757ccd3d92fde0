"""One link to one Crazyflie: the only place that knows cflib, its threads and its traps.

- cflib opens a link with callbacks and without a time limit: over UDP it resends nothing, so one lost packet blocks it
  without end. Here packets are resent, and an attempt that stays silent for a while is given up.
- Its first two packets, for the version of the protocol, are not sent again even so: done here.
- cflib's `close_link` first sends a set-point without thrust. In flight it would take the drone from its high-level
  commander and drop it, so it is not sent.
- Its threads ask whether there is a link and then use it, while another thread takes it away: they die, one with a lock
  in its hands, and what they print may abort the interpreter as it ends. So a link that was closed or lost is replaced
  by one that takes everything and says nothing, and closing stops every thread and timer that was started.
- Once connected it reads all parameters: not done here (`FirmwareParameters`).
- cflib notices a dead radio link, but not a silent UDP one: `silent_s` does.
- cflib's calls may block (a radio's queue holds one packet): they run in threads, never on the event loop.
"""

from __future__ import annotations

import asyncio
import functools
import os
import tempfile
import threading
import time
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from llm_flock.extras import require
from llm_flock.robots import RobotError
from llm_flock_flight._crazyflie.parameters import PORT as PARAMETER_PORT
from llm_flock_flight._crazyflie.parameters import FirmwareParameters
from llm_flock_flight._crazyflie.threads import Worker, in_thread, new_thread

SILENCE_S, MAX_SILENCE_S = 1.0, 4.0
"""An attempt to open a link is given up after this silence [s]; each attempt has more patience, up to the second."""

AGAIN_S = 0.3  # the version of the protocol is asked for again after this time [s]
SEND_S = 2.5  # longest time to send one packet: cflib's radio driver gives up after 2 s [s]

HIGH_LEVEL_PORT = 8
SCHEMES = ("radio://", "udp://", "usb://", "tcp://", "serial://")
NETWORK = ("udp://", "tcp://")


def host_and_port(uri: str) -> tuple[str, int] | None:
    """Both of an address; None if it has not both, or a port that can be none."""
    try:
        parts = urlsplit(uri)
        return (parts.hostname, parts.port) if parts.hostname and parts.port else None
    except ValueError:
        return None


def default_folder() -> Path:
    """The folder of drones' tables, which take long to fetch: in this user's cache (XDG base directories)."""
    given = os.environ.get("XDG_CACHE_HOME", "")
    base = Path(given) if given.startswith("/") else Path.home() / ".cache"
    return base / "llm-flock" / "crazyflie"


def library() -> Any:
    """`cflib.crazyflie`, with its link drivers ready; raises InputError if it is not installed."""
    require("crazyflie", "a Crazyflie")
    from cflib import crazyflie, crtp  # pyright: ignore[reportMissingTypeStubs]

    drivers: Any = crtp
    if not drivers.CLASSES:
        drivers.init_drivers()
    return crazyflie


def in_reach() -> tuple[str, ...]:
    """Addresses of the Crazyflies that answer by radio (as shipped), by cable or at local UDP ports; takes seconds."""
    library()
    from cflib import crtp  # pyright: ignore[reportMissingTypeStubs]

    drivers: Any = crtp
    return tuple(str(found[0]) for found in drivers.scan_interfaces())


class Unusable(RobotError):
    """The firmware lacks something that a flight needs: trying again does not help."""


class NoLink:
    """Takes the place of cflib's driver in a link that was closed or lost."""

    needs_resending = False

    def send_packet(self, _packet: object) -> None:
        """Drop it."""

    def receive_packet(self, wait: float = 0.0) -> None:
        """Nothing comes."""
        time.sleep(min(0.05, max(0.0, wait)))

    def close(self) -> None:
        """It is closed."""


class CrazyflieLink:
    """One link, opened and closed once. Arguments as those of `CrazyflieRobot`."""

    def __init__(self, name: str, uri: str, cache: Path | None) -> None:
        self.lost: str | None = None
        self.quality: float | None = None
        self._name = name
        self._uri = uri
        self._cache = cache or default_folder()
        self._cf: Any = None
        self._heard_s = 0.0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._answers: dict[int, asyncio.Future[int]] = {}
        self._worker: Worker | None = None
        self._parameters: FirmwareParameters | None = None

    @property
    def open(self) -> bool:
        """Whether packets can be handed to it."""
        return self._cf is not None and self._cf.link is not None and not isinstance(self._cf.link, NoLink)

    @property
    def heard_s(self) -> float:
        """When the last packet came [s; `time.monotonic`]."""
        return self._heard_s

    @property
    def parameters(self) -> FirmwareParameters:
        """The parameters of the drone; raises RobotError unless the link is open."""
        if self._parameters is None:
            self._parameters = FirmwareParameters(self._name, self.cf.param.toc, self.send_packet)
        return self._parameters

    @property
    def cf(self) -> Any:
        """The `Crazyflie` of cflib; raises RobotError unless the link is open."""
        if not self.open:
            raise RobotError(self._name, self.why_closed)
        return self._cf

    @property
    def why_closed(self) -> str:
        """The reason why nothing can be sent."""
        return f"the link is lost: {self.lost}" if self.lost else "is not connected"

    def silent_s(self, now: float) -> float:
        """Time since the last packet [s]."""
        return now - self._heard_s

    async def connect(self, timeout_s: float) -> None:
        """Open the link and fetch the tables; retry for `timeout_s`, then raise RobotError."""
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
                await self._attempt(end, min(MAX_SILENCE_S, attempts * SILENCE_S))
            except (TimeoutError, RobotError) as error:
                why = error.what if isinstance(error, RobotError) else "no answer"
                await self.close()
                await asyncio.sleep(min(0.1, max(0.0, end - time.monotonic())))
            except BaseException:
                await self.close()
                raise
            else:
                return

    async def _attempt(self, end: float, patience_s: float) -> None:
        """Try once to open the link, until `end` or a silence; raises RobotError or TimeoutError."""
        self.lost, self._heard_s = None, time.monotonic()
        cf = self._cf = library().Crazyflie(rw_cache=str(self._cache))
        keep_whole(cf, self._cache)
        cf.commander.send_setpoint = _nothing
        cf.param.request_update_of_all_params = _nothing
        cf._link_error_cb = functools.partial(self._fail, cf)  # noqa: SLF001
        ready, known = asyncio.Event(), threading.Event()
        by_udp = self._uri.startswith("udp://")
        begin, go_on = cf._start_connection_setup, cf._platform_info_fetched  # noqa: SLF001

        def done(_uri: str) -> None:
            self._call(ready.set)

        def begin_with_resending() -> None:
            if by_udp:
                cf.link.needs_resending = True
            begin()

        def go_on_once() -> None:
            if not known.is_set():
                known.set()
                go_on()

        cf._start_connection_setup = begin_with_resending  # noqa: SLF001
        cf._platform_info_fetched = go_on_once  # noqa: SLF001
        cf.connected.add_callback(done)
        cf.connection_failed.add_callback(self._lose)
        cf.packet_received.add_callback(self._hear)
        cf.link_statistics.link_quality_updated.add_callback(self._rate)
        cf.add_port_callback(HIGH_LEVEL_PORT, self._on_answer)
        cf.add_port_callback(PARAMETER_PORT, self._on_parameter)
        await in_thread(lambda: cf.open_link(self._uri), end - time.monotonic())
        asked_s = time.monotonic()
        while not ready.is_set():
            now = time.monotonic()
            if self.lost is not None:
                raise RobotError(self._name, self.lost)
            if now >= end or self.silent_s(now) > patience_s:
                raise TimeoutError
            if by_udp and not known.is_set() and now - asked_s > AGAIN_S:
                asked_s = now
                cf.platform._request_protocol_version()  # noqa: SLF001
            try:
                async with asyncio.timeout(min(0.1, end - now)):
                    await ready.wait()
            except TimeoutError:
                continue

    async def log(
        self,
        name: str,
        period_ms: int,
        variables: Mapping[str, str],
        take: Callable[[Mapping[str, float], float], None],
        needed: Collection[str] = (),
    ) -> tuple[str, ...]:
        """Start a log block of variables, given by name with their types in packets; returns those it cannot log.

        Its period is a multiple of 10 ms. `take` gets the values by name and their arrival [s], in cflib's thread.
        Raises Unusable without one of `needed`, and RobotError as `send`.
        """

        def on_data(_stamp: int, data: dict[str, float], _block: object) -> None:
            take(data, time.monotonic())

        table = self.cf.log.toc
        missing = tuple(v for v in variables if table.get_element(*v.split(".", 1)) is None)
        for variable in missing:
            if variable in needed:
                raise Unusable(self._name, f"the firmware does not log {variable}: update it")
        if len(missing) == len(variables):
            return missing
        block = library().log.LogConfig(name, period_ms)
        for variable, kind in variables.items():
            if variable not in missing:
                block.add_variable(variable, kind)
        block.data_received_cb.add_callback(on_data)
        self.cf.log.add_config(block)
        try:
            await in_thread(block.start, SEND_S)
        except TimeoutError:
            raise RobotError(self._name, "the link takes no packet") from None
        return missing

    def logs(self, variable: str) -> bool:
        """Whether the firmware has a log variable of this name."""
        return self.cf.log.toc.get_element_by_complete_name(variable) is not None

    async def send(self, call: Callable[[Any], None], *, urgent: bool = False) -> None:
        """Send something with cflib's `Crazyflie` or raise RobotError; something urgent overtakes the queue."""
        cf = self.cf
        worker = self._worker = self._worker or Worker()
        try:
            await in_thread(lambda: call(cf), SEND_S, new_thread if urgent else worker.do)
        except TimeoutError:
            self._end_worker()
            raise RobotError(self._name, "the link takes no packet") from None

    async def send_packet(self, port: int, channel: int, data: bytes) -> None:
        """Send one packet, in order with everything else; raises as `send` does."""
        from cflib.crtp.crtpstack import CRTPPacket  # pyright: ignore[reportMissingTypeStubs]

        packet: Any = CRTPPacket()
        packet.set_header(port, channel)
        packet.data = data
        await self.send(lambda cf: cf.send_packet(packet))

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
            async with asyncio.timeout(timeout_s):
                return await answer
        except TimeoutError:
            return None
        finally:
            self._answers.pop(command, None)

    async def close(self) -> None:
        """Close the link; the drone flies on."""
        self._end_worker()
        cf, self._cf, self._parameters = self._cf, None, None
        if cf is None:
            return

        await in_thread(lambda: shut(cf), 10.0)

    # The rest is called in cflib's threads.

    def _call(self, call: Callable[..., object], *arguments: object) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(call, *arguments)

    def _hear(self, _packet: object) -> None:
        self._heard_s = time.monotonic()

    def _fail(self, cf: Any, why: str) -> None:
        """The driver gives up, in whichever thread: instead of `Crazyflie._link_error_cb`."""
        self._lose("", why)
        link, cf.link = cf.link, NoLink()
        if link is not None:
            link.close()

    def _on_parameter(self, packet: Any) -> None:
        self._call(self._pass_on, packet.channel, bytes(packet.data))

    def _pass_on(self, channel: int, data: bytes) -> None:
        if self._parameters is not None:
            self._parameters.hear(channel, data)

    def _lose(self, _uri: str, why: str) -> None:
        self.lost = self.lost or (why.strip().splitlines() or ["link error"])[0]

    def _rate(self, percent: float) -> None:
        self.quality = min(1.0, max(0.0, percent / 100.0))

    def _on_answer(self, packet: Any) -> None:
        data = bytes(packet.data)
        if len(data) >= 4:
            self._call(self._settle, data[0], data[3])

    def _settle(self, command: int, result: int) -> None:
        answer = self._answers.get(command)
        if answer is not None and not answer.done():
            answer.set_result(result)


def _nothing(*_: object) -> None:
    """Replaces a set-point without thrust."""


def shut(cf: Any) -> None:
    """Close a link of cflib's, with everything that it started."""
    link, cf.link = cf.link, NoLink()
    cf.incoming.stop()
    if link is not None:
        link.close()
    with cf._send_lock:  # noqa: SLF001
        for timer in cf._answer_patterns.values():  # noqa: SLF001  # they would send again
            timer.cancel()
        cf._answer_patterns.clear()  # noqa: SLF001
    if cf.incoming.is_alive():
        cf.incoming.join(1.5)  # it looks once a second
    cf.disconnected.call(cf.link_uri)  # ends cflib's threads for parameters and statistics


def keep_whole(cf: Any, folder: Path) -> None:
    """Let a `Crazyflie` of cflib write each table whole: others read the file while drones that connect write it."""
    cache = cf._toc_cache  # noqa: SLF001

    def insert(checksum: int, table: object) -> None:
        with tempfile.TemporaryDirectory(dir=folder) as draft:
            type(cache)(rw_cache=draft).insert(checksum, table)
            file = f"{checksum:08X}.json"
            (Path(draft) / file).replace(folder / file)

    cache.insert = insert
