"""Estimate the model calls, tokens and cost of a run by a rehearsal with a stand-in, before any model is asked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from llm_flock.llm._models import cost_usd, parse_models, waits
from llm_flock.llm._port import Usage
from llm_flock.llm._providers import parse_base_urls, parse_model
from llm_flock.runtime._api import run
from llm_flock.runtime._config import RunConfig
from llm_flock.runtime._planners import check_planners
from llm_flock.runtime._trial import TrialProgress

OUTPUT_TOKENS = 400
"""Tokens that an answer of a real model is taken to have, reasoning included."""

PROFILE = "distorted@0.3,overshoot@0.3"
"""Failures of the stand-in that rehearses for a real model."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Expected:
    """Expected use of one run, or of several.

    Attributes:
        calls: model calls, retries of rejected answers included.
        tokens_input: tokens in.
        tokens_output: tokens out, reasoning included.
        cost_usd: by list prices [US dollars]; None where the price of a model is not known.
        at_most: calls if every robot asked for a plan and a step in every round, each as often as is allowed.
    """

    calls: float = 0.0
    tokens_input: float = 0.0
    tokens_output: float = 0.0
    cost_usd: float | None = 0.0
    at_most: int = 0

    def __add__(self, other: Expected) -> Expected:
        return Expected(
            calls=self.calls + other.calls,
            tokens_input=self.tokens_input + other.tokens_input,
            tokens_output=self.tokens_output + other.tokens_output,
            cost_usd=None if self.cost_usd is None or other.cost_usd is None else self.cost_usd + other.cost_usd,
            at_most=self.at_most + other.at_most,
        )

    def times(self, count: float) -> Expected:
        """The expected use of `count` of these."""
        return replace(
            self,
            calls=count * self.calls,
            tokens_input=count * self.tokens_input,
            tokens_output=count * self.tokens_output,
            cost_usd=None if self.cost_usd is None else count * self.cost_usd,
            at_most=round(count * self.at_most),
        )


def stand_in(config: RunConfig, profile: str = PROFILE) -> RunConfig:
    """The configuration with a free model that answers at once, and without budget and files.

    A simulated model that does not wait stands for itself. Any other one is replaced by a simulated model with the
    failures of `profile`, which gets the same questions.
    """
    model = config.model
    names = parse_models(model.model, config.mission.n_robots)
    if any(waits(name) or parse_model(name).kind == "replay" for name in names):
        plain = {"model": f"simulated:{profile}", "base_url": None, "reasoning_effort": None}
        # Stand-ins understand only the full prompts, so the tokens of brief ones are overestimated.
        prompts = None if model.prompts == "brief" else model.prompts
        plain |= {"temperature": None, "model_seed": None, "prompts": prompts, "frame": None}
        model = model.model_copy(update=plain)
    free = {"max_calls": None, "max_tokens": None, "max_cost": None}
    parts = {
        "model": model.model_copy(update={"record_llm": None}),
        "limits": config.limits.model_copy(update=free),
        "trial": config.trial.model_copy(update={"out": None}),
    }
    return config.model_copy(update=parts)


def rehearse(config: RunConfig, on_round: Callable[[TrialProgress], None] | None = None) -> Expected:
    """The use of a run of a stand-in. It takes as long as that run: seconds for 60 robots, many minutes for 1000."""
    found = run(config=config, on_round=on_round, progress=False, trace=False).summary
    return Expected(calls=found.model_calls, tokens_input=found.tokens_input, tokens_output=found.tokens_output)


def priced(config: RunConfig, found: Expected, output_tokens: int = OUTPUT_TOKENS) -> Expected:
    """The use that a rehearsal `found`, in terms of the models of `config`; each robot is taken to use as much."""
    texts = parse_models(config.model.model, config.mission.n_robots)
    names = [parse_model(text) for text in texts]
    addresses = parse_base_urls(config.model.base_url, texts)
    calls = found.calls / len(names)
    tokens_input = found.tokens_input / max(1.0, found.calls)
    total = Expected(at_most=most_calls(config))
    for name in names:
        if name.kind in ("geometry", "replay"):
            continue  # asks no model
        real = name.kind in ("provider", "plugin", "own")
        answer = output_tokens if real else found.tokens_output / max(1.0, found.calls)
        cost: float | None = 0.0
        if name.kind == "own":
            cost = None  # its class may charge anything
        elif name.kind == "provider":
            provider = name.provider if name.provider not in addresses else None
            cost = cost_usd(provider, name.model, Usage(input=round(tokens_input), output=round(answer)))
        one = Expected(calls=1.0, tokens_input=tokens_input, tokens_output=answer, cost_usd=cost)
        total += one.times(calls)
    return total


def expect_run(config: RunConfig, on_round: Callable[[TrialProgress], None] | None = None) -> Expected:
    """The expected use of one run; `on_round` is called after each round of its rehearsal.

    No model is asked, and no file is written.

    Raises:
        InputError: a model cannot work, as far as that is known without a key.
    """
    check_planners(config, asks=False)
    return priced(config, rehearse(stand_in(config), on_round))


def most_calls(config: RunConfig) -> int:
    """Calls if every robot asked for a plan and a step each round, and every answer but the last were rejected."""
    most = config.mission.n_robots * 2 * config.most_rounds * (config.model.max_retries + 1)
    return most if config.limits.max_calls is None else min(most, config.limits.max_calls)
