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
    burst: float | None = Field(
        default=None, ge=1, le=1e6, description="Mean losses in a row on a link [1 / (1 - loss)]"
    )
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

    def is_lost(self, before: bool, rng: np.random.Generator) -> bool:
        """Draw whether a link that did or did not lose the message `before` loses the next one.

        With `burst` it is Gilbert's channel (1960), Elliott's with a bad state that loses all. Where bursts of that
        length cannot make a share as high as `loss`, it is as high as they can.
        """
        begins, goes_on = self.loss, self.loss
        if self.burst is not None and self.loss < 1.0:
            begins, goes_on = self.loss / (self.burst * (1.0 - self.loss)), 1.0 - 1.0 / self.burst
        return bool(rng.random() < (goes_on if before else begins))


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
        self._lost: dict[tuple[int, int], bool] = {}  # whether a link has lost its last message
        self.traffic = Traffic()

    def broadcast(self, payload: bytes, receivers: tuple[int, ...], sender: int = 0) -> None:
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
                self._lost[sender, receiver] = faults.is_lost(self._lost.get((sender, receiver), False), rng)
                if self._lost[sender, receiver]:
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
