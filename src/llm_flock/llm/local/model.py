"""The language model of one robot on top of an engine that it shares with the others."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from llm_flock.errors import InputError
from llm_flock.llm.client import CallSettings
from llm_flock.llm.grammar import answer_grammar, longest_answer, tokens_of
from llm_flock.llm.local.engine import ENGINES, Engine, Engines
from llm_flock.llm.local.weights import Weights, find_weights, head_of
from llm_flock.llm.port import Call, Reply

TEMPERATURE = 0.0
"""Numbers are wanted, not variety."""

LONGEST = 512
"""Tokens of an answer whose form is not known."""

LEAST_CONTEXT = 1024


def context_for(call: Call) -> int:
    """Tokens that a question with its answer needs at most, with room for it to be asked again; a power of two."""
    tokens = sum(tokens_of(message.text) for message in call.messages) + _longest(call)
    return max(LEAST_CONTEXT, 1 << (2 * tokens - 1).bit_length())


def _longest(call: Call) -> int:
    return LONGEST if call.form is None else longest_answer(call.kind, call.form)


class Berths:
    """The engines that one pool of models uses, from the first question to the pool's end."""

    def __init__(self, engines: Engines = ENGINES) -> None:
        self._engines = engines
        self._leased: dict[Weights, asyncio.Task[Engine]] = {}

    async def engine(self, weights: Weights, call: Call) -> Engine:
        """The engine for these files, loaded if it has to be; the first question says how much it has to hold.

        Raises:
            InputError: it cannot be loaded.
        """
        if weights not in self._leased:
            trained = head_of(weights.model).trained_context
            context = context_for(call) if trained is None else min(trained, context_for(call))
            load = asyncio.to_thread(self._engines.lease, weights, context)
            self._leased[weights] = asyncio.create_task(load)
        # Who stops waiting does not stop the others' engine, and `aclose` finds it when it is loaded.
        return await asyncio.shield(self._leased[weights])

    async def aclose(self) -> None:
        """Give all engines back."""
        while self._leased:
            _, lease = self._leased.popitem()
            with suppress(InputError):  # it never came to be, as those who asked it were told
                await asyncio.to_thread(self._engines.give_back, await lease)


class LocalModel:
    """A `LanguageModel` on board. It costs nothing and needs no network.

    Args:
        name: `local:...`, as configured.
        berths: where its engine is.
        settings: how to sample; temperature 0 unless told otherwise.
        clock: seconds, only differences matter.

    Raises:
        InputError: a file or the engine is missing or unfit, or a setting is of no use here.
    """

    def __init__(
        self,
        name: str,
        berths: Berths,
        settings: CallSettings | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        settings = settings or CallSettings()
        if settings.reasoning is not None:
            raise InputError("reasoning_effort", settings.reasoning, f"nothing with {name}, which has no such setting")
        self.weights = find_weights(name.partition(":")[2])
        self._name = name
        self._berths = berths
        self._clock = clock
        self._settings: dict[str, Any] = {"temperature": TEMPERATURE, **settings.plain()}

    @property
    def name(self) -> str:
        """`local:...`, as configured."""
        return self._name

    async def ask(self, call: Call) -> Reply:
        """Answer one call, in the form that it asks for.

        Raises:
            InputError: the engine cannot be loaded.
            ModelError: it does not take the question, or was stopped.
        """
        engine = await self._berths.engine(self.weights, call)
        started = self._clock()
        stop = threading.Event()
        try:
            answer = await asyncio.wrap_future(engine.submit(self._body(call), stop))
        finally:
            stop.set()  # whoever no longer waits for an answer frees its place
        return Reply(
            text=answer.text,
            model=self._name,
            settings=self._settings,
            usage=answer.usage,
            cost_usd=0.0,
            latency_s=self._clock() - started,
        )

    def _body(self, call: Call) -> dict[str, Any]:
        body: dict[str, Any] = {
            "messages": [{"role": message.role, "content": message.text} for message in call.messages],
            "max_tokens": _longest(call),
            "chat_template_kwargs": {"enable_thinking": False},
            **self._settings,
        }
        if call.form is not None:
            body["grammar"] = answer_grammar(call.kind, call.form)
        elif call.schema is not None:
            body["json_schema"] = dict(call.schema)
        return body
