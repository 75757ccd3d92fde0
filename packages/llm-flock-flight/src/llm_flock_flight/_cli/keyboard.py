"""The operator's keys in flight: one lets all drones return, one lands them, one cuts all motors."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import threading
from typing import TYPE_CHECKING, Self, TextIO, cast

if TYPE_CHECKING:
    from llm_flock_flight._flight.flight import Flight

LAND_KEYS = frozenset("lL ")  # keys that land all drones: l, or the space bar
RETURN_KEYS = frozenset("rR")  # keys that let all drones return to their starts
CUT_KEYS = frozenset("xX")  # keys that cut all motors


def _standard_input() -> int | None:
    """Its number; None for a program that was started without it."""
    given = cast("TextIO | None", sys.stdin)
    return None if given is None else given.fileno()


async def ask(question: str) -> str:
    """Ask the operator; returns a line of standard input.

    The thread that waits for it holds no lock and ends with the program, so Ctrl-C works without Enter.
    """
    loop = asyncio.get_running_loop()
    answer: asyncio.Future[str] = loop.create_future()

    def settle(text: str) -> None:
        if not answer.done():
            answer.set_result(text)

    def wait() -> None:
        number, text = _standard_input(), ""
        with contextlib.suppress(OSError):  # nobody is there to answer
            text = "" if number is None else os.read(number, 4096).decode(errors="ignore")
        with contextlib.suppress(RuntimeError):  # the loop is closed, the answer is not needed
            loop.call_soon_threadsafe(settle, text)

    sys.stderr.write(question)
    sys.stderr.flush()
    threading.Thread(target=wait, daemon=True).start()
    return await answer


class Keyboard(contextlib.ExitStack):
    """Handles a terminal's keys and signals while the event loop runs; leaves the terminal as it was.

    Ctrl-C and SIGTERM land all drones, a second one cuts all motors. A terminal that is closed lands them, however
    often that is told. Before a flight begins all of these end the program. Call `listen` once the flight has begun:
    until then, typing answers a question. From then on no key stops the program or its output.
    """

    def __init__(self, flight: Flight) -> None:
        super().__init__()
        self._flight = flight
        self._signals = 0

    def __enter__(self) -> Self:
        loop = asyncio.get_running_loop()
        task = asyncio.current_task()
        assert task is not None
        self._task = task
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, self._on_signal)
            self.callback(loop.remove_signal_handler, number)
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as nohup has it
            loop.add_signal_handler(signal.SIGHUP, self._land_or_end)
            self.callback(loop.remove_signal_handler, signal.SIGHUP)
        return self

    def listen(self) -> None:
        """Treat keys as commands from now on; does nothing without a terminal."""
        number = _standard_input()
        if number is None or not os.isatty(number):
            return
        import termios
        import tty

        loop = asyncio.get_running_loop()
        before = termios.tcgetattr(number)

        def restore() -> None:
            with contextlib.suppress(termios.error):  # it may have been closed
                termios.tcsetattr(number, termios.TCSANOW, before)

        self.callback(restore)
        tty.setcbreak(number)
        now = termios.tcgetattr(number)
        now[0] &= ~termios.IXON  # Ctrl-S
        now[6][termios.VSUSP] = b"\0"  # Ctrl-Z
        termios.tcsetattr(number, termios.TCSANOW, now)
        loop.add_reader(number, self._on_keys)
        self.callback(loop.remove_reader, number)

    def _on_keys(self) -> None:
        try:
            typed = os.read(sys.stdin.fileno(), 64)
        except OSError:
            typed = b""
        if not typed:  # the terminal is closed, and would stay ready to be read
            asyncio.get_running_loop().remove_reader(sys.stdin.fileno())
            self._flight.abort()
        for key in typed.decode(errors="ignore"):
            if key in CUT_KEYS:
                self._flight.emergency()
            elif key in LAND_KEYS:
                self._flight.abort()
            elif key in RETURN_KEYS:
                self._flight.return_home()

    def _on_signal(self) -> None:
        self._signals += 1
        if self._signals > 1:
            self._flight.emergency()
        else:
            self._land_or_end()

    def _land_or_end(self) -> None:
        if not self._flight.abort():
            self._task.cancel()
