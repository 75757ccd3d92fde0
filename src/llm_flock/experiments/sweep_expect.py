"""Forecast the use of a sweep before it is flown: a stand-in rehearses each cell once."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

from llm_flock.experiments.grid import TrialSpec
from llm_flock.experiments.sweep_file import ExpectTable, Sweep
from llm_flock.experiments.trial import TrialResult
from llm_flock.llm.models import parse_models
from llm_flock.llm.port import Usage
from llm_flock.llm.prices import cost_usd
from llm_flock.llm.providers import parse_base_urls, parse_model
from llm_flock.runtime.api import run
from llm_flock.runtime.config import RunConfig
from llm_flock.runtime.trial import TrialProgress

REHEARSAL_S = 5.0
"""A rehearsal stops after this time, and its use is extrapolated to the last round [s]."""


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
        known = self.cost_usd is not None and other.cost_usd is not None
        return Expected(
            calls=self.calls + other.calls,
            tokens_input=self.tokens_input + other.tokens_input,
            tokens_output=self.tokens_output + other.tokens_output,
            cost_usd=(self.cost_usd or 0.0) + (other.cost_usd or 0.0) if known else None,
            at_most=self.at_most + other.at_most,
            wall_s=self.wall_s + other.wall_s,
        )

    def times(self, count: float) -> Expected:
        """The expected use of `count` of these."""
        return Expected(
            calls=count * self.calls,
            tokens_input=count * self.tokens_input,
            tokens_output=count * self.tokens_output,
            cost_usd=None if self.cost_usd is None else count * self.cost_usd,
            at_most=round(count * self.at_most),
            wall_s=count * self.wall_s,
        )


def expect_cells(
    sweep: Sweep,
    *,
    flown: Mapping[str, Iterable[TrialResult]] | None = None,
    on_cell: Callable[[str], None] | None = None,
) -> dict[str, Expected]:
    """The expected use of one trial of each cell.

    A cell with finished trials is expected to go on as they did. Any other cell is rehearsed with its first seed: by
    its own model if that is a stand-in that does not wait, else by the one in `[expect]`, which gets the same
    questions, and whose answers are taken to have `output_tokens` tokens each.

    Args:
        sweep: the sweep.
        flown: finished trials by cell.
        on_cell: called before a cell is rehearsed.
    """
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
    """The use of one trial of a stand-in, extrapolated where it takes long."""
    began = time.perf_counter()
    last: list[TrialProgress] = []

    def note(now: TrialProgress) -> None:
        last[:] = [now]
        if time.perf_counter() - began > REHEARSAL_S:
            raise _LongEnough

    with suppress(_LongEnough):
        return replace(_measured(run(config=config, on_round=note).summary.to_dict()), at_most=_at_most(config))
    (now,) = last
    so_far = Expected(calls=now.model_calls, tokens_input=now.tokens, wall_s=time.perf_counter() - began)
    return replace(so_far.times(now.rounds / max(1, now.round)), at_most=_at_most(config))


def _priced(spec: TrialSpec, found: Expected, expect: ExpectTable) -> Expected:
    """A rehearsal's use in terms of the real models, taking each robot to use as much as any other."""
    config = spec.config
    names = [parse_model(text) for text in parse_models(config.model.model, config.mission.n_robots)]
    addresses = parse_base_urls(config.model.base_url, spec.models)
    calls = [found.calls / len(names) if name.kind not in ("geometry", "replay") else 0.0 for name in names]
    answers = [expect.output_tokens if name.kind in ("provider", "local") else 0.0 for name in names]
    output = sum(count * tokens for count, tokens in zip(calls, answers, strict=True))
    share = found.tokens_input / max(1.0, found.calls)
    cost: float | None = 0.0
    for name, count, tokens in zip(names, calls, answers, strict=True):
        if name.kind == "provider" and cost is not None:
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
    most = config.mission.n_robots * 2 * config.trial.rounds * (config.model.max_retries + 1)
    return most if config.limits.max_calls is None else min(most, config.limits.max_calls)
