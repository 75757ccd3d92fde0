"""The cost of a sweep: expected before it flies, and counted while it flies."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace

from llm_flock.llm import Spent
from llm_flock.runtime import Expected, RunConfig, check_planners, most_calls, priced, rehearse, stand_in
from llm_flock_lab._experiments.executors import Display
from llm_flock_lab._experiments.grid import TrialSpec
from llm_flock_lab._experiments.sweep_file import Sweep
from llm_flock_lab._experiments.trial import TrialResult


def expect_cells(
    sweep: Sweep,
    *,
    flown: Mapping[str, Iterable[TrialResult]] | None = None,
    on_cell: Callable[[str], None] | None = None,
) -> dict[str, Expected]:
    """The expected use of one trial of each cell.

    A cell with finished trials goes on as they did. Any other one is rehearsed with its first seed, as `[expect]` says;
    `on_cell` is called before. Cells whose rehearsals are the same share one.
    """
    configs: dict[str, RunConfig] = {}
    for spec in sweep.trials:
        configs.setdefault(spec.cell, spec.config)
    for config in configs.values():
        check_planners(config, asks=False)
    expect = sweep.file.expect
    found: dict[str, Expected] = {}
    rehearsed: dict[str, Expected] = {}
    for cell, config in configs.items():
        known = [r.summary for r in (flown or {}).get(cell, ()) if not r.cut and r.summary is not None]
        if known:
            total = sum((_expectation(summary) for summary in known), Expected())
            found[cell] = replace(total.times(1 / len(known)), at_most=most_calls(config))
            continue
        double = stand_in(config, expect.profile)
        key = double.model_dump_json()
        if key not in rehearsed:
            if on_cell is not None:
                on_cell(cell)
            rehearsed[key] = rehearse(double)
        found[cell] = priced(config, rehearsed[key], expect.output_tokens)
    return found


def _expectation(summary: Mapping[str, float]) -> Expected:
    return Expected(
        calls=summary["model_calls"],
        tokens_input=summary["tokens_input"],
        tokens_output=summary["tokens_output"],
        cost_usd=summary["cost_usd"],
    )


class Tally(Display):
    """Counts trials, and forecasts the use of a cell's other trials from those that are over."""

    def __init__(
        self,
        clock: Callable[[], float] = time.monotonic,
        on_change: Callable[[bool], None] = lambda began: None,
    ) -> None:
        self._clock = clock
        self._on_change = on_change
        self._began = clock()
        self._of_cell: defaultdict[str, Spent] = defaultdict(Spent)
        self._count: Counter[str] = Counter()
        self._left: Counter[str] = Counter()
        self._flown: Counter[str] = Counter()
        self.trials = self.over = self.formed = self.broken = self.cut = 0
        self.used = Spent()

    def begin(self, flown: Collection[TrialResult], pending: Sequence[TrialSpec]) -> None:
        again = {spec.id for spec in pending}
        for result in flown:
            if result.id not in again:
                self._count_in(result.cell, result)
        for spec in pending:
            self._left[spec.cell] += 1
        self.trials = self.over + len(pending)
        self._began = self._clock()
        self._on_change(True)

    def finished(self, spec: TrialSpec, result: TrialResult) -> None:
        self._left[spec.cell] -= 1
        self._flown[spec.cell] += 1
        self._count_in(spec.cell, result)
        self._on_change(False)

    def spent(self, spent: Spent, reason: str | None) -> None:
        self.used = spent
        self._on_change(False)

    @property
    def forecast(self) -> Spent:
        """Expected use of all trials together, at least what is spent already."""
        rest = Spent()
        for cell, left in self._left.items():
            one = self._one(cell)
            rest += Spent(calls=round(left * one.calls), tokens=round(left * one.tokens), cost_usd=left * one.cost_usd)
        total = sum(self._of_cell.values(), Spent()) + rest
        return Spent(
            calls=max(total.calls, self.used.calls),
            tokens=max(total.tokens, self.used.tokens),
            cost_usd=max(total.cost_usd, self.used.cost_usd),
        )

    @property
    def eta_s(self) -> float | None:
        """Expected time left [s], where a trial takes as long as its calls; None before the first trial is over."""
        done = sum(count * (self._one(cell).calls or 1) for cell, count in self._flown.items())
        left = sum(count * (self._one(cell).calls or 1) for cell, count in self._left.items())
        return left * (self._clock() - self._began) / done if done > 0 else None

    def _count_in(self, cell: str, result: TrialResult) -> None:
        self._count[cell] += 1
        self._of_cell[cell] += result.spent
        self.over += 1
        self.formed += result.formed
        self.broken += result.error is not None
        self.cut += result.cut

    def _one(self, cell: str) -> Spent:
        """Use of one trial of the cell: the mean so far, of all trials where none of this cell is over."""
        alike = [cell] if self._count[cell] else list(self._count)
        used, count = sum((self._of_cell[one] for one in alike), Spent()), sum(self._count[one] for one in alike)
        if not count:
            return Spent()
        return Spent(calls=used.calls // count, tokens=used.tokens // count, cost_usd=used.cost_usd / count)
