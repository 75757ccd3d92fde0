"""A model of a Crazyradio that stand-ins share, as cflib uses one. It is a model: no radio was measured for it.

Sans-IO: packets and the time go in, deliveries come out. The radio does one exchange after another: a packet to one
drone, or an empty one to ask, and with the answer at most one packet of that drone. Drones have their turns in order.
One that had nothing to say ten times in a row is asked every 10 ms only, as cflib's driver does. The packets of a lost
exchange stay where they are.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np

Delivery: TypeAlias = tuple[int, Literal["up", "down"], bytes]
"""A drone by its number, whether the packet is for it or from it, and the packet."""

RELAXED_S = 0.01
"""Time between two questions then [s] (cflib: `radiodriver.py`)."""

QUEUE = 40
"""Most packets of one drone that wait in each direction; further ones are dropped."""

BEHIND_S = 0.2
"""A model that is served later than this skips the time [s]: its computer stalled, not the radio."""


@dataclass(slots=True)
class _Link:
    """One drone's packets that wait, with the times since when."""

    up: deque[tuple[float, bytes]] = field(default_factory=lambda: deque[tuple[float, bytes]]())
    down: deque[tuple[float, bytes]] = field(default_factory=lambda: deque[tuple[float, bytes]]())
    empty: int = 0
    due_s: float = 0.0

    def ready_s(self) -> float:
        """When it is asked next, at the earliest."""
        return min(self.due_s, self.up[0][0]) if self.up else self.due_s


class ModelledRadio:
    """One radio and the drones that it serves, which are numbered as they come; an exchange takes `exchange_s`.

    It counts `exchanges`, lost ones included, and `dropped` packets, for which there was no room; `waited_s` has how
    long the last packet of each drone had waited [s].
    """

    def __init__(self, exchange_s: float, *, loss: float = 0.0, seed: int = 0) -> None:
        self.exchanges = self.dropped = 0
        self.waited_s: dict[int, float] = {}
        self._exchange_s, self._loss = exchange_s, loss
        self._rng = np.random.default_rng(seed)
        self._links: dict[int, _Link] = {}
        self._order: deque[int] = deque()
        self._free_s = 0.0

    def put(self, drone: int, way: Literal["up", "down"], packet: bytes, now: float) -> None:
        """Queue a packet for a drone, or one of it."""
        if drone not in self._links:
            self._links[drone] = _Link(due_s=now)
            self._order.append(drone)
        queue = getattr(self._links[drone], way)
        if len(queue) >= QUEUE:
            self.dropped += 1
        else:
            queue.append((now, packet))

    def step(self, now: float) -> list[Delivery]:
        """Do all exchanges until `now`; returns what was delivered, in order."""
        self._free_s = max(self._free_s, now - BEHIND_S)
        found: list[Delivery] = []
        while self._links:
            drone = next((k for k in self._order if self._links[k].ready_s() <= self._free_s), None)
            if drone is None:
                self._free_s = min(link.ready_s() for link in self._links.values())
                if self._free_s > now:
                    return found
                continue
            if self._free_s + self._exchange_s > now:
                return found
            self._free_s += self._exchange_s
            self._order.remove(drone)
            self._order.append(drone)
            self.exchanges += 1
            if not (self._loss > 0.0 and self._rng.random() < self._loss):
                found += self._exchange(drone)
        return found

    def _exchange(self, drone: int) -> list[Delivery]:
        link, at = self._links[drone], self._free_s
        found: list[Delivery] = []
        if link.up:
            found.append((drone, "up", link.up.popleft()[1]))
        if link.down and link.down[0][0] <= at:
            since_s, packet = link.down.popleft()
            self.waited_s[drone] = at - since_s
            found.append((drone, "down", packet))
            link.empty = 0
        else:
            link.empty += 1
        link.due_s = at + RELAXED_S if link.empty > 10 else at  # as cflib does
        return found
