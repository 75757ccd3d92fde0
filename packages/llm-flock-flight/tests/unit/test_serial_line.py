"""A serial line whose device is slow."""

from __future__ import annotations

import threading
import time

from llm_flock_flight._mavlink.serial_line import SerialLine


class Device:
    """A device that never has anything to read, and whose first write times out."""

    def __init__(self) -> None:
        self.tried: list[bytes] = []
        self.closed = threading.Event()
        self.in_waiting = 0

    def read(self, _size: int) -> bytes:
        time.sleep(0.01)
        return b""

    def write(self, packet: bytes) -> None:
        self.tried.append(packet)
        if len(self.tried) == 1:
            raise OSError("write timeout")

    def close(self) -> None:
        self.closed.set()


def test_a_write_that_times_out_costs_its_packet_alone() -> None:
    device = Device()
    line = SerialLine(device, lambda _data: None)
    for packet in (b"first", b"second", b"third"):
        line.send(packet, None)
    end = time.monotonic() + 10.0
    while len(device.tried) < 3 and time.monotonic() < end:
        time.sleep(0.01)
    line.close()
    assert device.tried == [b"first", b"second", b"third"]
    assert device.closed.wait(10.0)
