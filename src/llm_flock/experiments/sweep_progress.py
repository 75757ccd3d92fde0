"""How far a sweep has come while it flies, what it has used, and what is to be expected of the rest."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from llm_flock.experiments.executors import Flight, Landed
from llm_flock.experiments.store import StoredTrial
from llm_flock.experiments.sweep_expect import Expected
from llm_flock.llm.sharing import Spent
from llm_flock.runtime.trial import TrialProgress

NEARLY = 0.95
"""A trial that is under way counts as no more of a whole one than this."""


class Tally:
    """Counts trials, and forecasts from those that are over what the others of their cell will use.

    Args:
        expected: what one trial of a cell is expected to use, where anything is known.
        clock: seconds, only differences matter.

    Attributes:
        trials: all of them.
        over: those that are over, found ones included.
        formed: of these.
        broken: of these, those that broke off.
        cut: those that the budget of the sweep cut short.
        spent: what all processes have spent, earlier sessions included.
        reason: which limit of the budget is used up.
    """

    def __init__(
        self, expected: Mapping[str, Expected] | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._expected = dict(expected or {})
        self._clock = clock
        self._began = clock()
        self._used: defaultdict[str, Spent] = defaultdict(Spent)
        self._count: Counter[str] = Counter()
        self._left: Counter[str] = Counter()
        self._size: dict[str, float] = {}
        self._under_way: dict[str, tuple[str, TrialProgress]] = {}
        self._flown: Counter[str] = Counter()
        self.trials = self.over = self.formed = self.broken = self.cut = 0
        self.spent = Spent()
        self.reason: str | None = None

    def begin(self, flown: Mapping[str, Sequence[StoredTrial]], pending: Sequence[Flight]) -> None:
        """See `sweep.Display`."""
        for cell, trials in flown.items():
            self._size[cell] = max(_size(trial.config) for trial in trials)
        again = {flight.spec.id for flight in pending}
        for cell, trials in flown.items():
            for trial in trials:
                if trial.id not in again:
                    self._count_in(cell, Landed.of(trial, fresh=False))
        for flight in pending:
            cell = flight.spec.cell
            self._left[cell] += 1
            self._size[cell] = flight.spec.config.mission.n_robots * flight.spec.config.trial.rounds
        self.trials = self.over + len(pending)
        self._began = self._clock()

    def progress(self, flight: Flight, now: TrialProgress) -> None:
        """See `executors.Watcher`."""
        self._under_way[flight.spec.id] = flight.spec.cell, now

    def landed(self, flight: Flight, landed: Landed) -> None:
        """A trial is over."""
        cell = flight.spec.cell
        self._under_way.pop(flight.spec.id, None)
        self._left[cell] -= 1
        self._flown[cell] += landed.fresh
        self._count_in(cell, landed)

    def account(self, spent: Spent, reason: str | None) -> None:
        """See `executors.Watcher.spent`."""
        self.spent, self.reason = spent, reason or self.reason

    @property
    def forecast(self) -> Spent:
        """What all trials together will have used in the end, as far as can be told; at least what is spent."""
        rest = Spent()
        for cell, left in self._left.items():
            one = self._one(cell)
            rest += Spent(calls=round(left * one.calls), tokens=round(left * one.tokens), cost_usd=left * one.cost_usd)
        over = sum(self._used.values(), Spent())
        total = over + rest
        return Spent(
            calls=max(total.calls, self.spent.calls),
            tokens=max(total.tokens, self.spent.tokens),
            cost_usd=max(total.cost_usd, self.spent.cost_usd),
        )

    @property
    def eta_s(self) -> float | None:
        """Time that is left [s]; None before anything can be said."""
        flown = sum(count * self._work(cell) for cell, count in self._flown.items())
        part = sum(self._part(cell, now) * self._work(cell) for cell, now in self._under_way.values())
        left = sum(count * self._work(cell) for cell, count in self._left.items()) - part
        done = flown + part
        return left * (self._clock() - self._began) / done if done > 0 else None

    def _count_in(self, cell: str, landed: Landed) -> None:
        self._count[cell] += 1
        self._used[cell] += landed.spent
        self.over += 1
        self.formed += landed.formed
        self.broken += landed.error is not None
        self.cut += landed.cut

    def _one(self, cell: str) -> Spent:
        """What one trial of the cell uses."""
        if self._count[cell]:
            used, count = self._used[cell], self._count[cell]
            return Spent(calls=used.calls // count, tokens=used.tokens // count, cost_usd=used.cost_usd / count)
        known = self._expected.get(cell)
        if known is not None:
            return Spent(calls=round(known.calls), tokens=round(known.tokens), cost_usd=known.cost_usd or 0.0)
        # As the other cells, by its size.
        size = sum(self._size.get(other, 0.0) * count for other, count in self._count.items())
        if not size:
            return Spent()
        share, used = self._size[cell] / size, sum(self._used.values(), Spent())
        return Spent(calls=round(share * used.calls), tokens=round(share * used.tokens), cost_usd=share * used.cost_usd)

    def _work(self, cell: str) -> float:
        """How much there is to do in one trial, in calls, or by its size where nothing else is known."""
        return self._one(cell).calls or self._size.get(cell, 1.0)

    def _part(self, cell: str, now: TrialProgress) -> float:
        """How much of a trial under way is done."""
        return min(NEARLY, max(now.model_calls / max(1.0, self._work(cell)), now.round / max(1, now.rounds)))


def _size(config: Mapping[str, Any]) -> float:
    """Robots times rounds at most."""
    return config["mission"]["n_robots"] * config["trial"]["rounds"]
