"""Estimate the model calls, tokens and cost of a run by a rehearsal with a stand-in, before any model is asked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass
from typing import Any

from llm_flock.llm._limits import LONGEST_S
from llm_flock.llm._models import parse_models, waits
from llm_flock.llm._port import Usage
from llm_flock.llm._providers import cost_usd, parse_base_urls, parse_model
from llm_flock.runtime._api import run
from llm_flock.runtime._config import RunConfig
from llm_flock.runtime._planners import check_planners
from llm_flock.runtime._trial import TrialProgress

OUTPUT_TOKENS = 400  # assumed tokens of a real model's answer, with reasoning
PROFILE = "distorted@0.3,overshoot@0.3"  # failures of the stand-in that rehearses for a real model


@dataclass(frozen=True, slots=True)
class Expected:
    """Expected use of one run, or of several; retries of rejected answers and reasoning are included."""

    calls: float = 0.0
    tokens_input: float = 0.0
    tokens_output: float = 0.0
    cost_usd: float | None = 0.0  # by list prices [US dollars]; None where the price of a model is not known
    at_most: int = 0  # calls if every robot asked for a plan and a step in every round, each as often as is allowed

    def __add__(self, other: Expected) -> Expected:
        pairs = zip(astuple(self), astuple(other), strict=True)
        values: list[Any] = [None if None in pair else sum(pair) for pair in pairs]
        return Expected(*values)

    def times(self, count: float) -> Expected:
        """The expected use of `count` of these."""
        values: list[Any] = [None if value is None else count * value for value in astuple(self)]
        return Expected(*values)


def stand_in(config: RunConfig, profile: str = PROFILE) -> RunConfig:
    """The configuration with a free model that answers at once, and without budget, files and the user's own code.

    A simulated model that does not wait stands for itself, one with the failures of `profile` for any other.
    """
    free, outside = RunConfig.stored(config.model_dump())
    plain: dict[str, str | None] = {"prompts": config.model.prompts}
    if "model" in outside or any(map(waits, parse_models(config.model.model, config.mission.n_robots))):
        plain |= {"model": f"simulated:{profile}", "reasoning_effort": None}
        plain |= {"temperature": None, "model_seed": None, "frame": None}
        if config.model.prompts in (
            "brief",
            "brief-program",
        ):  # stand-ins understand only the full ones, which take more tokens
            plain["prompts"] = None
    # On a busy machine a rehearsal takes longer; that must not cost it an answer.
    unbounded = {"max_calls": None, "max_tokens": None, "max_cost": None, "timeout_s": LONGEST_S}
    parts = {"model": free.model.model_copy(update=plain), "limits": config.limits.model_copy(update=unbounded)}
    return free.model_copy(update=parts)


def rehearse(config: RunConfig, on_round: Callable[[TrialProgress], None] | None = None) -> Expected:
    """The use of a stand-in's run. Takes as long as that run: seconds for 60 robots, many minutes for 1000."""
    use = run(config=config, on_round=on_round, progress=False, trace=False).summary
    return Expected(calls=use.model_calls, tokens_input=use.tokens_input, tokens_output=use.tokens_output)


def priced(config: RunConfig, rehearsed: Expected, output_tokens: int = OUTPUT_TOKENS) -> Expected:
    """The use of a rehearsal at the prices of the models of `config`, if all robots use as much."""
    texts = parse_models(config.model.model, config.mission.n_robots)
    names = [parse_model(text) for text in texts]
    addresses = parse_base_urls(config.model.base_url, texts)
    calls, asked = rehearsed.calls / len(names), max(1.0, rehearsed.calls)
    total = Expected(at_most=most_calls(config))
    for name in names:
        if name.kind in ("geometry", "replay"):
            continue  # asks no model
        tokens_input, answer = rehearsed.tokens_input / asked, rehearsed.tokens_output / asked
        if name.kind in ("provider", "plugin", "own"):
            answer = output_tokens
        cost: float | None = None if name.kind == "own" else 0.0  # a class of one's own may charge anything
        if name.kind == "provider":
            provider = name.provider if name.provider not in addresses else None
            cost = cost_usd(provider, name.model, Usage(input=round(tokens_input), output=round(answer)))
        cost = None if cost is None else calls * cost
        total += Expected(calls, calls * tokens_input, calls * answer, cost)
    return total


def expect_run(config: RunConfig, on_round: Callable[[TrialProgress], None] | None = None) -> Expected:
    """The expected use of one run, by a rehearsal that asks no model and writes no file."""
    check_planners(config, asks=False)
    return priced(config, rehearse(stand_in(config), on_round))


def most_calls(config: RunConfig) -> int:
    """Calls if every robot asked for a plan and a step each round, and every answer but the last were rejected."""
    most = config.mission.n_robots * 2 * config.most_rounds * (config.model.max_retries + 1)
    return most if config.limits.max_calls is None else min(most, config.limits.max_calls)
