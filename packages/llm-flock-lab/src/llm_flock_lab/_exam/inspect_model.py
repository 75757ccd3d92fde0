"""Our models as models of Inspect, named `flock/MODEL` with MODEL as in `llm-flock run --model`, and theirs as ours."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextvars import ContextVar
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from llm_flock.errors import InputError, ModelError
from llm_flock.extras import require
from llm_flock.llm import (
    Budget,
    BudgetMeter,
    Call,
    CallLimits,
    CallSettings,
    LanguageModel,
    Limited,
    ModelPool,
    OwnModel,
    ReplayModel,
    Reply,
    Usage,
    check_priced,
    habits_of,
    parse_base_urls,
    parse_model,
    source_of,
)

require("exam", "llm-flock exam")

# By name, because the library is not installed where types are checked.
_model: Any = import_module("inspect_ai.model")
ModelAPI: Any = _model.ModelAPI

PREFIX = "flock"  # Inspect's name for the provider of our models


class AskedByInspect:
    """A `LanguageModel` that asks through Inspect, which logs and counts; one for each question."""

    def __init__(self, model: Any, robot: int, round_: int) -> None:
        self.name = str(model)
        self.robot = robot
        self.round = round_
        self.call: Call | None = None
        self.answers: LanguageModel | None = None
        self.reply: Reply | None = None
        self._model = model

    async def ask(self, call: Call) -> Reply:
        """Answer one call; a failure of Inspect's model is a ModelError, after the retries that Inspect makes."""
        made: dict[str, Any] = {
            "system": _model.ChatMessageSystem,
            "user": _model.ChatMessageUser,
            "assistant": _model.ChatMessageAssistant,
        }
        messages = [made[message.role](content=message.text) for message in call.messages]
        self.call, self.reply = call, None
        before = _ASKED.set(self)
        began = time.perf_counter()
        try:
            output: Any = await self._model.generate(messages)
        except (OSError, RuntimeError) as error:
            raise ModelError("server", f"{type(error).__name__}: {error}") from error
        finally:
            _ASKED.reset(before)
        if output.error is not None:
            raise ModelError("server", str(output.error))
        if self.reply is not None:
            return self.reply
        used = output.usage
        return Reply(
            text=str(output.completion),
            model=self.name,
            usage=Usage() if used is None else Usage.reported(used.input_tokens, used.output_tokens),
            cost_usd=None if used is None else used.total_cost,
            latency_s=time.perf_counter() - began,
        )


_ASKED: ContextVar[AskedByInspect] = ContextVar("asked")
"""The question under way: Inspect hands messages to a model, and ours need the robot, the round and the form too."""


class FlockModel(ModelAPI):
    """A model by its name in this project, with its retries, time-outs and prices."""

    def __init__(self, model_name: str, base_url: str | None = None, api_key: str | None = None, **other: Any) -> None:
        base: Any = super()
        base.__init__(model_name, base_url=base_url, api_key=api_key, **other)
        name = parse_model(model_name)
        self.kind = name.kind
        self.limits = CallLimits(rng=np.random.default_rng(0))
        self._urls = parse_base_urls(base_url, (model_name,))
        self._pool = ModelPool()
        self._typed = False  # a log of Inspect may name an address, too
        self._name = name
        self._source = source_of(name.provider) if name.kind == "plugin" else None
        self._own = OwnModel.load(model_name) if name.kind == "own" else None
        self._replay = ReplayModel(Path(name.model)) if name.kind == "replay" else None

    @property
    def simulated(self) -> bool:
        of_others = self._own or self._replay
        return habits_of(self._name.text).simulated or (of_others is not None and of_others.simulated)

    @property
    def files(self) -> Mapping[str, str]:
        """Digests of its files by name, if a plug-in provides it; empty for others."""
        return {} if self._source is None else self._source.digests(self._name.model)

    def prepare(self, settings: CallSettings, budget: Budget, *, max_concurrent: int, timeout_s: float) -> None:
        """Check that the model can be asked with these settings, and set its limits. Call before the first question."""
        check_priced(budget.max_cost_usd, (self.model_name,), self._urls)
        self._typed = True
        if self._source is not None:
            max_concurrent = min(max_concurrent, self._source.at_once)
        if self.kind in ("plugin", "provider", "simulated"):
            rng = np.random.default_rng(0)
            self._pool.model(self.model_name, rng=rng, settings=settings, base_urls=self._urls, typed=True)
        self.limits = CallLimits(
            rng=np.random.default_rng(0),
            max_concurrent=max_concurrent,
            timeout_s=timeout_s,
            meter=BudgetMeter(budget),
        )

    def _for_question(self, robot: int, round_: int, config: Any) -> LanguageModel:
        if self._replay is not None:
            return self._replay
        if self._own is not None:
            return Limited(self._own, self.limits)
        if self.kind == "geometry":
            raise InputError("model", self.model_name, "another model: geometry reads no prompts")
        settings = CallSettings(
            temperature=config.temperature,
            seed=config.seed,
            reasoning=config.reasoning_effort,
            max_tokens=config.max_tokens,
        )
        # The answers to a question must not depend on which others were asked before it.
        rng = np.random.default_rng([0, round_, robot])
        # A wait that is too long belongs to the limits, so the connection's own is longer.
        options: Any = {"base_urls": self._urls, "timeout_s": 2 * self.limits.timeout_s, "typed": self._typed}
        return Limited(self._pool.model(self.model_name, rng=rng, settings=settings, **options), self.limits)

    async def generate(self, input: Any, tools: Any, tool_choice: Any, config: Any) -> Any:
        asked = _ASKED.get(None)
        if asked is None or asked.call is None:
            raise InputError("model", f"{PREFIX}/{self.model_name}", "a model of Inspect: this one sits our exam only")
        if asked.answers is None:
            asked.answers = self._for_question(asked.robot, asked.round, config)
        try:
            if self.kind == "simulated" and asked.call.form is None:
                raise ModelError("refused", "a simulated model reads no missions in words")
            reply = await asked.answers.ask(asked.call)
        except ModelError as error:
            if error.kind != "refused" or not self.simulated:
                raise
            # A stand-in that cannot read words has not answered the question.
            reply = Reply(text=str(error), model=self.model_name, usage=Usage(), cost_usd=0.0, latency_s=0.0)
        asked.reply = reply
        output = _model.ModelOutput.from_content(reply.model, reply.text)
        used = reply.usage
        output.usage = _model.ModelUsage(
            input_tokens=max(0, used.input - used.cached),
            output_tokens=used.output,
            total_tokens=used.total,
            input_tokens_cache_read=used.cached or None,
            total_cost=reply.cost_usd,
        )
        return output

    async def aclose(self) -> None:
        await self._pool.aclose()
        if self._replay is not None:
            self._replay.close()
        if self._own is not None:
            await self._own.aclose()


_model.modelapi(name=PREFIX)(FlockModel)
