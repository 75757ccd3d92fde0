"""Forecast the use of a sweep: before it is flown by stand-ins, and while it is flown by its trials so far."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import Any

from llm_flock.experiments.executors import Display
from llm_flock.experiments.grid import TrialSpec
from llm_flock.experiments.smaller_rehearsal import LARGE, rehearse_small, scaled, smaller_team
from llm_flock.experiments.sweep_file import ExpectTable, Sweep
from llm_flock.experiments.trial import TrialResult
from llm_flock.llm.limits import Spent
from llm_flock.llm.models import parse_models
from llm_flock.llm.port import Usage
from llm_flock.llm.prices import cost_usd
from llm_flock.llm.providers import parse_base_urls, parse_model
from llm_flock.runtime.api import run
from llm_flock.runtime.config import RunConfig
from llm_flock.runtime.planners import check_planners
from llm_flock.runtime.trial import TrialProgress

REHEARSAL_S = 5.0
"""A rehearsal stops after this time; a small team, or else its first rounds, say what the rest takes [s]."""

NEARLY = 0.95
"""Largest part of a whole trial that a trial in flight counts as."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Expected:
    """Expected use of one trial, or of several.

    Attributes:
        calls: model calls, retries of rejected answers included.
        tokens_input: tokens in.
        tokens_output: tokens out, reasoning included.
        cost_usd: by list prices [US dollars]; None where the price of a model is not known.
        at_most: calls if every robot asked for a plan and a step in every round, each as often as is allowed.
        wall_s: time that the stand-ins took [s].
    """

    calls: float = 0.0
    tokens_input: float = 0.0
    tokens_output: float = 0.0
    cost_usd: float | None = 0.0
    at_most: int = 0
    wall_s: float = 0.0

    @property
    def tokens(self) -> float:
        """In and out."""
        return self.tokens_input + self.tokens_output

    def __add__(self, other: Expected) -> Expected:
        pairs = {name: (value, getattr(other, name)) for name, value in asdict(self).items()}
        total: dict[str, Any] = {name: None if None in pair else sum(pair) for name, pair in pairs.items()}
        return Expected(**total)

    def times(self, count: float) -> Expected:
        """The expected use of `count` of these."""
        values = {name: None if value is None else count * value for name, value in asdict(self).items()}
        return replace(self, **values | {"at_most": round(count * self.at_most)})


def expect_cells(
    sweep: Sweep,
    *,
    flown: Mapping[str, Iterable[TrialResult]] | None = None,
    on_cell: Callable[[str], None] | None = None,
) -> dict[str, Expected]:
    """The expected use of one trial of each cell.

    A cell with finished trials is expected to go on as they did. Any other cell is rehearsed with its first seed: by
    its own model if that is a stand-in that does not wait, else by the one in `[expect]`, which gets the same
    questions, and whose answers are taken to have `output_tokens` tokens each. Before that, `on_cell` is called.

    Raises:
        InputError: a model cannot work, as far as that is known without a key.
    """
    for spec in {spec.cell: spec for spec in sweep.trials}.values():
        check_planners(spec.config, asks=False)
    found: dict[str, Expected] = {}
    rehearsed: dict[str, Expected] = {}
    for spec in sweep.trials:
        if spec.cell in found:
            continue
        known = [r.summary for r in (flown or {}).get(spec.cell, ()) if not r.cut and r.summary is not None]
        if known:
            mean = sum(map(_measured, known), Expected()).times(1 / len(known))
            found[spec.cell] = replace(mean, at_most=_at_most(spec.config))
            continue
        stand_in = _stand_in(spec, sweep.file.expect)
        key = stand_in.model_dump_json()
        if key not in rehearsed:
            if on_cell is not None:
                on_cell(spec.cell)
            rehearsed[key] = _rehearse(stand_in)
        found[spec.cell] = _priced(spec, rehearsed[key], sweep.file.expect)
    return found


def expect_run(config: RunConfig, expect: ExpectTable) -> tuple[Expected, bool]:
    """The expected use of one run, and whether it was rehearsed by the stand-in of `expect`, as cells of a sweep are.

    Neither a model is asked nor a file written.

    Raises:
        InputError: a model cannot work, as far as that is known without a key.
    """
    check_planners(config, asks=False)
    no_files = {"trial": config.trial.model_copy(update={"out": None})}
    no_files |= {"model": config.model.model_copy(update={"record_llm": None})}
    spec = TrialSpec(id="", cell="", axes={}, config=config.model_copy(update=no_files))
    stand_in = _stand_in(spec, expect)
    return _priced(spec, _rehearse(stand_in), expect), stand_in.model.model != spec.config.model.model


def _measured(summary: Mapping[str, float]) -> Expected:
    return Expected(
        calls=summary["model_calls"],
        tokens_input=summary["tokens_input"],
        tokens_output=summary["tokens_output"],
        cost_usd=summary["cost_usd"],
        wall_s=summary["wall_s"],
    )


def _stand_in(spec: TrialSpec, expect: ExpectTable) -> RunConfig:
    """The configuration with a free model that answers at once, and without budget and files."""
    config, model = spec.config, spec.config.model
    kinds = {parse_model(name).kind for name in spec.models}
    if spec.waits or "replay" in kinds:
        plain = {"model": f"simulated:{expect.profile}", "base_url": None, "reasoning_effort": None}
        # Stand-ins understand only the full prompts, so the tokens of brief ones are overestimated.
        prompts = None if model.prompts == "brief" else model.prompts
        plain |= {"temperature": None, "model_seed": None, "prompts": prompts, "frame": None}
        model = model.model_copy(update=plain)
    limits = config.limits.model_copy(update={"max_calls": None, "max_tokens": None, "max_cost": None})
    return config.model_copy(update={"model": model, "limits": limits})


class _LongEnough(Exception):
    """A rehearsal takes too long."""


def _rehearse(config: RunConfig) -> Expected:
    """The use of one trial of a stand-in; where that takes long, from a small team, or from its first rounds."""
    last: list[TrialProgress] = []
    began = time.perf_counter()
    small = smaller_team(config)
    if config.mission.n_robots <= LARGE or small is None:
        found = _fly(config, last, began)
        if found is not None:
            return replace(found, at_most=_at_most(config))
    if small is not None:
        use = scaled(config, small, *rehearse_small(small))
        found = Expected(
            calls=use.calls, tokens_input=use.tokens_input, tokens_output=use.tokens_output, wall_s=use.wall_s
        )
    else:
        (now,) = last
        so_far = Expected(calls=now.model_calls, tokens_input=now.tokens, wall_s=time.perf_counter() - began)
        found = so_far.times(now.rounds / max(1, now.round))
    return replace(found, at_most=_at_most(config))


def _fly(config: RunConfig, last: list[TrialProgress], began: float) -> Expected | None:
    """Fly a whole trial; None, with its `last` progress, where that takes too long."""

    def note(now: TrialProgress) -> None:
        last[:] = [now]
        if time.perf_counter() - began > REHEARSAL_S:
            raise _LongEnough

    with suppress(_LongEnough):
        return _measured(run(config=config, on_round=note, progress=False, trace=False).summary.to_dict())
    return None


def _priced(spec: TrialSpec, found: Expected, expect: ExpectTable) -> Expected:
    """A rehearsal's use in terms of the real models, taking each robot to use as much as any other."""
    config = spec.config
    names = [parse_model(text) for text in parse_models(config.model.model, config.mission.n_robots)]
    addresses = parse_base_urls(config.model.base_url, spec.models)
    calls = [found.calls / len(names) if name.kind not in ("geometry", "replay") else 0.0 for name in names]
    answers = [expect.output_tokens if name.kind in ("provider", "plugin", "own") else 0.0 for name in names]
    output = sum(count * tokens for count, tokens in zip(calls, answers, strict=True))
    share = found.tokens_input / max(1.0, found.calls)
    cost: float | None = 0.0
    for name, count, tokens in zip(names, calls, answers, strict=True):
        if name.kind == "own" and count:
            cost = None  # its class may charge anything
        elif name.kind == "provider" and cost is not None:
            provider = name.provider if name.provider not in addresses else None
            price = cost_usd(provider, name.model, Usage(input=round(share), output=round(tokens)))
            cost = None if price is None else cost + count * price
    return replace(
        found,
        calls=sum(calls),
        tokens_input=share * sum(calls),
        tokens_output=output if any(answers) else found.tokens_output,
        cost_usd=cost,
    )


def _at_most(config: RunConfig) -> int:
    """Calls if every robot asked for a plan and a step each round, and every answer but the last were rejected."""
    most = config.mission.n_robots * 2 * config.most_rounds * (config.model.max_retries + 1)
    return most if config.limits.max_calls is None else min(most, config.limits.max_calls)


class Tally(Display):
    """Counts trials, and forecasts the use of the other trials of a cell from those that are over.

    Args:
        expected: expected use of one trial of a cell, where anything is known.
        clock: seconds, only differences matter.
        on_change: called after each change; its argument is whether the sweep has just begun.

    Attributes:
        over: trials that are over, found ones included.
        formed: of these.
        broken: of these, those that broke off.
        cut: those that the budget of the sweep cut short.
        used: total of all processes, earlier sessions included.
    """

    def __init__(
        self,
        expected: Mapping[str, Expected] | None = None,
        clock: Callable[[], float] = time.monotonic,
        on_change: Callable[[bool], None] = lambda began: None,
    ) -> None:
        self._expected = expected or {}
        self._clock = clock
        self._on_change = on_change
        self._began = clock()
        self._of_cell: defaultdict[str, Spent] = defaultdict(Spent)
        self._count: Counter[str] = Counter()
        self._left: Counter[str] = Counter()
        self._size: dict[str, float] = {}
        self._in_flight: dict[str, tuple[str, TrialProgress]] = {}
        self._flown: Counter[str] = Counter()
        self.trials = self.over = self.formed = self.broken = self.cut = 0
        self.used = Spent()

    def begin(self, flown: Collection[TrialResult], pending: Sequence[TrialSpec]) -> None:
        """See `Display`."""
        again = {spec.id for spec in pending}
        for result in flown:
            rounds = result.config["trial"]["rounds"] or (result.summary or {}).get("rounds") or 1
            self._size[result.cell] = result.config["mission"]["n_robots"] * rounds
            if result.id not in again:
                self._count_in(result.cell, result)
        for spec in pending:
            self._left[spec.cell] += 1
            self._size[spec.cell] = spec.config.mission.n_robots * spec.config.most_rounds
        self.trials = self.over + len(pending)
        self._began = self._clock()
        self._on_change(True)

    def progress(self, spec: TrialSpec, now: TrialProgress) -> None:
        """See `Display`."""
        self._in_flight[spec.id] = spec.cell, now
        self._on_change(False)

    def finished(self, spec: TrialSpec, result: TrialResult, *, fresh: bool) -> None:
        """See `Display`."""
        self._in_flight.pop(spec.id, None)
        self._left[spec.cell] -= 1
        self._flown[spec.cell] += fresh
        self._count_in(spec.cell, result)
        self._on_change(False)

    def spent(self, spent: Spent, reason: str | None) -> None:
        """See `Display`."""
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
        """Expected time left [s]; None before the first round."""
        flown = sum(count * self._work(cell) for cell, count in self._flown.items())
        part = sum(self._part(cell, now) * self._work(cell) for cell, now in self._in_flight.values())
        left = sum(count * self._work(cell) for cell, count in self._left.items()) - part
        done = flown + part
        return left * (self._clock() - self._began) / done if done > 0 else None

    def _count_in(self, cell: str, result: TrialResult) -> None:
        self._count[cell] += 1
        self._of_cell[cell] += result.spent
        self.over += 1
        self.formed += result.formed
        self.broken += result.error is not None
        self.cut += result.cut

    def _one(self, cell: str) -> Spent:
        """Use of one trial of the cell: the mean so far, else as expected, else as other cells by its size."""
        if self._count[cell]:
            used, count = self._of_cell[cell], self._count[cell]
            return Spent(calls=used.calls // count, tokens=used.tokens // count, cost_usd=used.cost_usd / count)
        known = self._expected.get(cell)
        if known is not None:
            return Spent(calls=round(known.calls), tokens=round(known.tokens), cost_usd=known.cost_usd or 0.0)
        size = sum(self._size.get(other, 0.0) * count for other, count in self._count.items())
        if not size:
            return Spent()
        share, used = self._size[cell] / size, sum(self._of_cell.values(), Spent())
        return Spent(calls=round(share * used.calls), tokens=round(share * used.tokens), cost_usd=share * used.cost_usd)

    def _work(self, cell: str) -> float:
        """Amount of work in one trial: its calls, or its robots times rounds where no call is known."""
        return self._one(cell).calls or self._size.get(cell, 1.0)

    def _part(self, cell: str, now: TrialProgress) -> float:
        """Part of a trial in flight that is done."""
        return min(NEARLY, max(now.model_calls / max(1.0, self._work(cell)), now.round / max(1, now.rounds)))
