"""Messages in memory: radio range, loss, delay, duplication and reordering, all seeded."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class LinkFaults(BaseModel):
    """Faults of the links, drawn for each message on each link independently."""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)

    loss: Share = Field(default=0.0, description="Probability that a message is lost on a link")
    delay: int = Field(
        default=0, ge=0, le=1000, description="Longest delay [communication rounds]; messages draw 0..delay"
    )
    duplicate: Share = Field(default=0.0, description="Probability that a message arrives twice")
    reorder: Share = Field(
        default=0.0, description="Probability that a robot gets the messages of a communication round in random order"
    )

    @property
    def any(self) -> bool:
        """Whether anything can go wrong."""
        return bool(self.loss or self.delay or self.duplicate or self.reorder)


@dataclass(slots=True)
class Traffic:
    """Totals since the start: broadcasts, their bytes, and messages delivered and lost on the links."""

    sent: int = 0
    bytes: int = 0
    delivered: int = 0
    lost: int = 0


class MemoryTransport:
    """Delivers broadcasts, with the faults of the links, which `rng` draws."""

    def __init__(self, n_robots: int, faults: LinkFaults, rng: np.random.Generator) -> None:
        self._n_robots = n_robots
        self.faults = faults
        self._rng = rng
        self._tick = 0
        self._due: defaultdict[int, list[tuple[int, bytes]]] = defaultdict(list)
        self.traffic = Traffic()

    def broadcast(self, payload: bytes, receivers: tuple[int, ...]) -> None:
        """Send one payload to every receiver in range."""
        self.traffic.sent += 1
        self.traffic.bytes += len(payload)
        if not self.faults.any:
            self._due[self._tick] += [(receiver, payload) for receiver in receivers]
            return
        faults, rng = self.faults, self._rng
        for receiver in receivers:
            copies = 1 + int(rng.random() < faults.duplicate)
            for _ in range(copies):
                if rng.random() < faults.loss:
                    self.traffic.lost += 1
                    continue
                late = int(rng.integers(0, faults.delay + 1)) if faults.delay else 0
                self._due[self._tick + late].append((receiver, payload))

    def deliver(self) -> list[tuple[int, bytes]]:
        """The messages of this communication round, as (receiver, payload) in order of arrival. Begins the next."""
        arriving = self._due.pop(self._tick, [])
        self._tick += 1
        self.traffic.delivered += len(arriving)
        if self.faults.reorder and arriving:
            shuffled = set(np.flatnonzero(self._rng.random(self._n_robots) < self.faults.reorder).tolist())
            mixed = [item for item in arriving if item[0] in shuffled]
            order = self._rng.permutation(len(mixed))
            return [item for item in arriving if item[0] not in shuffled] + [mixed[k] for k in order]
        return arriving
