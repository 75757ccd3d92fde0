"""A serial line to one or more vehicles, read and written by threads: pyserial blocks."""

from __future__ import annotations

import contextlib
import errno
import queue
import threading
import time
from collections.abc import Callable
from importlib import import_module
from typing import Any

from llm_flock.extras import require

MAX_PACKETS = 200  # packets that may wait to be written; more than that are dropped, as a radio does


class SerialLine:
    """An open line. `on_data` gets bytes in a thread of this line."""

    def __init__(self, device: Any, on_data: Callable[[bytes], None]) -> None:
        self._device = device
        self._on_data = on_data
        self._open = True
        self._packets: queue.Queue[bytes | None] = queue.Queue(MAX_PACKETS)
        for work in (self._read, self._write):
            threading.Thread(target=work, name="mavlink", daemon=True).start()

    def send(self, packet: bytes, to: Any) -> None:
        """Queue a packet; a line has no other address."""
        with contextlib.suppress(queue.Full):
            self._packets.put_nowait(packet)

    def close(self) -> None:
        """Close the line; its threads end."""
        self._open = False
        with contextlib.suppress(queue.Full):
            self._packets.put_nowait(None)

    def _read(self) -> None:
        try:
            while self._open:
                data = self._device.read(max(1, self._device.in_waiting))
                if data:
                    self._on_data(bytes(data))
        except (OSError, RuntimeError):
            pass  # unplugged, or the event loop has ended: the missing heartbeats show it
        finally:
            self._device.close()

    def _write(self) -> None:
        while self._open and (packet := self._packets.get()) is not None:
            # A write that times out costs its packet; of a line that was unplugged, the missing heartbeats tell.
            with contextlib.suppress(OSError):
                self._device.write(packet)


def open_serial(path: str, baud: int, on_data: Callable[[bytes], None]) -> SerialLine:
    """Open a line; OSError says why it cannot."""
    require("mavlink", "a serial line")
    library: Any = import_module("serial")
    end = time.monotonic() + 1.0  # a line of our own that was just closed is free by then
    while True:
        try:
            device = library.Serial(path, baud, timeout=0.1, write_timeout=1.0, exclusive=True)
        except (ValueError, OverflowError) as error:
            raise OSError(str(error)) from error
        except OSError as error:
            if error.errno not in (errno.EWOULDBLOCK, errno.EBUSY):
                raise
            if time.monotonic() >= end:
                message = "another program has this line, such as a ground station or a flight: end it"
                raise OSError(error.errno, message) from error
            time.sleep(0.05)
        else:
            _keep_to_ourselves(device)
            return SerialLine(device, on_data)


def _keep_to_ourselves(device: Any) -> None:
    """Have the system refuse the line to programs that ignore the lock, as long as it is open."""
    with contextlib.suppress(ImportError, OSError, AttributeError):
        import fcntl
        import termios

        fcntl.ioctl(device.fd, termios.TIOCEXCL)
