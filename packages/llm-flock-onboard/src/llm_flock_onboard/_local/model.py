"""The language model of one robot, on an engine that it shares with the others."""

from __future__ import annotations

import asyncio
import threading
import time
from contextlib import suppress
from dataclasses import replace
from typing import Any

from llm_flock.errors import InputError
from llm_flock.llm import Call, CallSettings, Reply, answer_grammar, answer_lead, longest_answer, tokens_of
from llm_flock_onboard._local.engine import ENGINES, Engine, Engines
from llm_flock_onboard._local.gguf import read_header
from llm_flock_onboard._local.weights import Weights, find_weights

MIN_CONTEXT = 1024

LONGEST_PROGRAM = 512
"""Longest program or mission of a small model [tokens]: memory for each question grows with it."""


def context_for(call: Call) -> int:
    """Context for a question and its answer, with room to ask once more [tokens]; a power of two."""
    tokens = sum(tokens_of(message.text) for message in call.messages) + _longest(call)
    return max(MIN_CONTEXT, 1 << (2 * tokens - 1).bit_length())


def _longest(call: Call) -> int:
    """Longest answer [tokens]; of a small model, no program is longer than `LONGEST_PROGRAM`."""
    return LONGEST_PROGRAM if call.form is None or call.form.program else longest_answer(call.kind, call.form)


class EngineLeases:
    """The engines that one pool of models uses, from the first question until `aclose`: a `ModelHost`."""

    def __init__(self, engines: Engines = ENGINES) -> None:
        self._engines = engines
        self._leased: dict[Weights, asyncio.Task[Engine]] = {}

    def model(self, text: str, settings: CallSettings | None) -> LocalModel:
        """See `ModelHost`."""
        return LocalModel(text, self, settings)

    async def engine(self, weights: Weights, call: Call) -> Engine:
        """The engine for these files, loaded if need be; the first question determines the context."""
        if weights not in self._leased:
            trained = read_header(weights.model).trained_context
            context = context_for(call) if trained is None else min(trained, context_for(call))
            load = asyncio.to_thread(self._engines.lease, weights, context)
            self._leased[weights] = asyncio.create_task(load)
        # A caller that gives up must not cancel loading for the others, and `aclose` has to find the engine.
        return await asyncio.shield(self._leased[weights])

    async def aclose(self) -> None:
        """Give back all engines."""
        while self._leased:
            _, lease = self._leased.popitem()
            with suppress(InputError):  # it was never loaded; its callers got the error
                await asyncio.to_thread(self._engines.give_back, await lease)


class LocalModel:
    """A `LanguageModel` on board, named `local:...` as configured. It costs nothing and needs no network.

    Raises:
        InputError: a file or the engine is missing or unfit, or a setting is of no use here.
    """

    def __init__(self, name: str, leases: EngineLeases, settings: CallSettings | None = None) -> None:
        settings = settings or CallSettings()
        if settings.reasoning is not None:
            raise InputError("reasoning_effort", settings.reasoning, says=f"{name} has no such setting")
        self.weights = find_weights(name.partition(":")[2])
        self.name = name
        self._leases = leases
        # The task needs the likeliest numbers, not variety.
        self._settings: dict[str, Any] = {"temperature": 0.0, **settings.plain()}

    async def ask(self, call: Call) -> Reply:
        """Answer one call, in the form that it asks for; InputError if the engine cannot be loaded, else ModelError."""
        engine = await self._leases.engine(self.weights, call)
        lead = "" if call.form is None else answer_lead(call.kind, call.form)
        started = time.perf_counter()
        stop = threading.Event()
        try:
            answer = await asyncio.wrap_future(engine.submit(self._body(call, lead), stop))
        finally:
            stop.set()  # a caller that gives up frees the slot
        latency_s = time.perf_counter() - started
        told = {"text": lead + answer.text, "model": self.name, "settings": self._settings}
        return replace(answer, **told, cost_usd=0.0, latency_s=latency_s)

    def _body(self, call: Call, lead: str) -> dict[str, Any]:
        longest = _longest(call)
        body: dict[str, Any] = {
            "messages": [{"role": message.role, "content": message.text} for message in call.messages],
            "chat_template_kwargs": {"enable_thinking": False},
            **self._settings,
            "max_tokens": min(longest, self._settings.get("max_tokens", longest)),
        }
        if call.form is not None:
            body["messages"] += [{"role": "assistant", "content": lead}] if lead else []
            body["grammar"] = answer_grammar(call.kind, call.form, lead)
        elif call.schema is not None:
            body["json_schema"] = dict(call.schema)
        return body
