"""Who sits the exam: a model by its name, with its prompts, settings and limits, as a robot would ask it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self, cast, get_args

import numpy as np

from llm_flock.errors import InputError
from llm_flock.llm.frame import FrameName
from llm_flock.llm.limits import Budget, BudgetMeter, CallLimits, Limited, Metered, RetryPolicy
from llm_flock.llm.local.engine import slot_count
from llm_flock.llm.local.weights import find_weights
from llm_flock.llm.models import ModelPool, check_priced, parse_settings
from llm_flock.llm.own import OwnModel
from llm_flock.llm.port import LanguageModel
from llm_flock.llm.prompting import PromptSet
from llm_flock.llm.providers import parse_base_urls, parse_model
from llm_flock.llm.replay import ReplayModel
from llm_flock.llm.sources import habits_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """How a model is asked. Defaults that are None are the model's own, as in `llm-flock run`.

    Attributes:
        model: as in `--model`, one for the whole exam.
        prompts: a packaged set of templates, or a folder.
        frame: coordinates of the prompts, `world` or `own`.
        answers: `text` or `json`.
        seed: chance of simulated models; every question has its own stream.
        max_retries: rejected answers that are sent back.
    """

    model: str
    prompts: str | None = None
    frame: str | None = None
    answers: str = "text"
    base_url: str | None = None
    temperature: str | None = None
    model_seed: str | None = None
    reasoning_effort: str | None = None
    max_answer_tokens: int | None = None
    seed: int = 0
    max_retries: int = 2
    max_concurrent: int = 8
    timeout_s: float = 120.0
    max_tries: int = 8
    max_calls: int | None = None
    max_tokens: int | None = None
    max_cost: float | None = None

    def asked(self) -> dict[str, Any]:
        """What changes questions or answers, without defaults: a result that is continued must have the same."""
        names = ("model", "prompts", "frame", "answers", "temperature", "model_seed", "reasoning_effort")
        names += ("max_answer_tokens", "seed", "max_retries")
        plain = asdict(self)
        defaults = asdict(Setup(model=""))
        return {name: plain[name] for name in names if name == "model" or plain[name] != defaults[name]}


def check_frame(frame: str) -> FrameName:
    """The coordinates of the prompts by their name.

    Raises:
        InputError: there are none of this name.
    """
    if frame not in get_args(FrameName):
        raise InputError("frame", frame, "world or own")
    return cast(FrameName, frame)


class Examinee:
    """A model that can be asked; an async context manager that closes connections, cassettes and engines.

    Attributes:
        name: as in `--model`.
        kind: of the model, as `parse_model` tells it.
        simulated: whether its answers come from a stand-in.
        prompts: templates in use.
        frame: coordinates of the prompts.
        meter: calls, tokens and money so far.

    Raises:
        InputError: the model cannot be asked, as far as is known before asking.
    """

    def __init__(self, setup: Setup, own: OwnModel | None = None) -> None:
        name = parse_model(setup.model) if own is None else None
        self.setup = setup
        self.name = setup.model if own is None else own.name
        self.kind = "own" if name is None else name.kind
        trained = habits_of(self.name).frame == "own"
        if setup.answers not in ("text", "json"):
            raise InputError("answers", setup.answers, "text or json")
        self.prompts = PromptSet.load(setup.prompts or ("brief" if trained else "full"), json=setup.answers == "json")
        self.frame: FrameName = check_frame(setup.frame or ("own" if trained else "world"))
        if self.kind == "simulated" and (setup.prompts or "full") != "full":
            raise InputError("prompts", setup.prompts, "full: simulated models understand no others")
        urls = parse_base_urls(setup.base_url, (self.name,)) if own is None else {}
        if own is None:
            check_priced(setup.max_cost, (self.name,), urls)
        self.meter = BudgetMeter(
            Budget(max_calls=setup.max_calls, max_tokens=setup.max_tokens, max_cost_usd=setup.max_cost)
        )
        at_once = min(setup.max_concurrent, slot_count()) if self.kind == "plugin" else setup.max_concurrent
        self._limits = CallLimits(
            rng=np.random.default_rng(setup.seed),
            max_concurrent=at_once,
            timeout_s=setup.timeout_s,
            retry=RetryPolicy(max_tries=setup.max_tries),
            meter=self.meter,
        )
        self._settings = parse_settings(
            1,
            temperature=setup.temperature,
            seed=setup.model_seed,
            reasoning=setup.reasoning_effort,
            max_tokens=setup.max_answer_tokens,
        )[0]
        self._pool = ModelPool(base_urls=urls, timeout_s=2 * setup.timeout_s)
        self._own = own
        if own is None and self.kind == "own":
            self._own = OwnModel.load(self.name)
        self._replay = ReplayModel(Path(name.model)) if name is not None and name.kind == "replay" else None
        self.simulated = (
            self.kind == "simulated"
            or (self._own is not None and self._own.simulated)
            or (self._replay is not None and self._replay.simulated)
        )

    def check(self) -> None:
        """Refuse a model whose key, address, file or profile is missing. Call before the first question."""
        if self.kind in ("plugin", "provider", "simulated"):
            self.model(0, 0)

    @property
    def reads_words(self) -> bool:
        """Whether it can be asked for a mission in plain words. Stand-ins and geometry cannot read any."""
        return self.kind in ("provider", "plugin", "own") or (self._replay is not None and not self.simulated)

    @property
    def weights(self) -> Mapping[str, str]:
        """Digests of the files of a model on board, by name; empty for others."""
        return find_weights(self.name.partition(":")[2]).versions() if self.kind == "plugin" else {}

    def model(self, robot: int, round_: int) -> LanguageModel:
        """The model behind one question, with the limits of the whole exam. Not for geometry, which is no model."""
        if self._replay is not None:
            return Metered(self._replay, self.meter)
        if self._own is not None:
            return Limited(self._own, self._limits)
        # The answers to a question must not depend on which others were asked before it.
        rng = np.random.default_rng([self.setup.seed, round_, robot])
        return Limited(self._pool.model(self.name, rng=rng, settings=self._settings), self._limits)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *error: object) -> None:
        await self._pool.aclose()
        if self._replay is not None:
            self._replay.close()
        if self._own is not None:
            await self._own.aclose()
