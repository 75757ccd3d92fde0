"""Simulates a Crazyradio shared by simulated drones, as cflib uses it. The timing is not measured on hardware.

Sans-IO: packets and the time go in, deliveries come out. The radio does one exchange after another: it sends one drone
a packet, or an empty one as a poll, and the answer brings at most one packet of that drone. Drones take turns. A drone
that had nothing to send ten times in a row is polled only every 10 ms, as by cflib's driver. The packets of a lost
exchange stay queued.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np

Delivery: TypeAlias = tuple[int, Literal["up", "down"], bytes]
"""A drone by its number, whether the packet is for it or from it, and the packet."""

SLOW_POLL_S = 0.01  # poll interval of a drone that had nothing to send [s] (cflib: `radiodriver.py`)
EMPTY_POLLS = 10  # number of empty polls in a row after which a drone is polled slowly
QUEUE_LENGTH = 40  # most packets of one drone that wait in each direction; further ones are dropped

MAX_LAG_S = 0.2
"""Longest simulated gap between calls of `step` [s]; a longer one is a stall of this computer and is skipped."""


@dataclass(slots=True)
class _Link:
    """One drone's queued packets, each with the time at which it was queued."""

    up: deque[tuple[float, bytes]] = field(default_factory=lambda: deque[tuple[float, bytes]]())
    down: deque[tuple[float, bytes]] = field(default_factory=lambda: deque[tuple[float, bytes]]())
    empty_polls: int = 0
    next_poll_s: float = 0.0

    def ready_s(self) -> float:
        """Earliest time of the next poll."""
        return min(self.next_poll_s, self.up[0][0]) if self.up else self.next_poll_s


class ModelledRadio:
    """One radio and the drones that it serves; an exchange takes `exchange_s`.

    It counts `exchanges`, lost ones included, and packets `dropped` as a queue was full. `last_wait_s` has the time
    that the last packet of each drone had waited [s].
    """

    def __init__(self, exchange_s: float, *, loss: float = 0.0, seed: int = 0) -> None:
        self.exchanges = self.dropped = 0
        self.last_wait_s: dict[int, float] = {}
        self._exchange_s, self._loss = exchange_s, loss
        self._rng = np.random.default_rng(seed)
        self._links: dict[int, _Link] = {}
        self._order: deque[int] = deque()
        self._free_s = 0.0

    def put(self, drone: int, way: Literal["up", "down"], packet: bytes, now: float) -> None:
        """Queue a packet to a drone (up) or from it (down)."""
        if drone not in self._links:
            self._links[drone] = _Link(next_poll_s=now)
            self._order.append(drone)
        link = self._links[drone]
        queue = link.up if way == "up" else link.down
        if len(queue) >= QUEUE_LENGTH:
            self.dropped += 1
        else:
            queue.append((now, packet))

    def step(self, now: float) -> list[Delivery]:
        """Do all exchanges until `now`; returns the deliveries in order."""
        self._free_s = max(self._free_s, now - MAX_LAG_S)
        deliveries: list[Delivery] = []
        while self._links:
            drone = next((k for k in self._order if self._links[k].ready_s() <= self._free_s), None)
            if drone is None:
                self._free_s = min(link.ready_s() for link in self._links.values())
                if self._free_s > now:
                    return deliveries
                continue
            if self._free_s + self._exchange_s > now:
                return deliveries
            self._free_s += self._exchange_s
            self._order.remove(drone)
            self._order.append(drone)
            self.exchanges += 1
            if not (self._loss > 0.0 and self._rng.random() < self._loss):
                deliveries += self._exchange(drone)
        return deliveries

    def _exchange(self, drone: int) -> list[Delivery]:
        link, at = self._links[drone], self._free_s
        deliveries: list[Delivery] = []
        if link.up:
            deliveries.append((drone, "up", link.up.popleft()[1]))
        if link.down and link.down[0][0] <= at:
            since_s, packet = link.down.popleft()
            self.last_wait_s[drone] = at - since_s
            deliveries.append((drone, "down", packet))
            link.empty_polls = 0
        else:
            link.empty_polls += 1
        link.next_poll_s = at + SLOW_POLL_S if link.empty_polls > EMPTY_POLLS else at  # as cflib does
        return deliveries
