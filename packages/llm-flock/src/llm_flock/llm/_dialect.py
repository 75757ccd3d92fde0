"""What a server refuses in a request though it is right, and how it is asked once more without it.

What providers are known to lack is in pydantic-ai's profiles. This is for the servers that nobody knows in advance.
"""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import Mapping
from contextlib import suppress
from itertools import groupby
from typing import Any, NamedTuple

from llm_flock.llm._port import ChatMessage
from llm_flock.printable import printable

logger = logging.getLogger(__name__)

FIRST_S = 1.0
"""Longest wait for the first answer of a server, from which the others learn its dialect [s]."""

_NAMES = {
    "roles": r"system (role|message|prompt)|role.{0,20}system|roles? must alternate|alternat\w+ (user|roles?)",
    "response_format": r"response_format|json_schema|json_object|structured outputs?",
    "max_completion_tokens": r"max_completion_tokens",
    "max_tokens": r"max_tokens",
    "temperature": r"temperature",
    "seed": r"\bseed\b",
    "reasoning": r"reasoning_effort|reasoning|thinking",
}
"""What may be left out of a request, by the words with which servers refuse it."""

_LARGE = re.compile(r"too (large|long|many)|exceeds?\b|greater than", re.IGNORECASE)
"""A request that names a setting because it is too large has the right form."""


class _Fault(NamedTuple):
    words: str
    """A regular expression for the words of a server's refusal, whatever their case."""
    status: int
    """The status of HTTP that such an error has, where the server sent 200."""
    advice: str = ""
    """What to change."""


CONTEXT = _Fault(
    r"context.{0,9} (length|size|window)|too many tokens|prompt is too long",
    400,
    "the question is longer than the context that the server gives: give it a larger one (servers divide it among "
    "the questions that they answer at once), or ask with --prompts brief",
)
FAULTS = (
    _Fault("rate.?limit|throttl|too many requests|request limit", 429),
    CONTEXT,
    _Fault("quota|balance|credit|billing|payment", 402),
    _Fault(
        r"\bmodel\b.{0,80}(not found|not exist|unknown)|(no such|unknown|invalid) model",
        404,
        "the server has no such model: check --model",
    ),
    _Fault(
        "status_code: 40[45]|not found|does not exist",
        404,
        "nothing at this address answers chats: check --base-url, which mostly ends in /v1",
    ),
    _Fault("api.key|unauthorized|authentication|permission", 401),
    _Fault("context|too long|too large|policy|policies|filter|flagged|safety|blocked|invalid|unsupported", 400),
)
"""What servers refuse; the first that fits."""

_refused: dict[tuple[str, str], list[str]] = {}


class Dialect:
    """What the server at an address refuses for a model. What is learned is kept for the process."""

    def __init__(self, address: str, model: str) -> None:
        self.name = f"{model} at {address}"
        self.without = _refused.setdefault((address, model), [])
        self._first: asyncio.Event | None = None
        self._said: set[str] = set()

    def say_once(self, what: str) -> None:
        """Tell the operator something about this server, once."""
        if what not in self._said:
            self._said.add(what)
            logger.warning("%s %s", self.name, what)

    async def turn(self) -> bool:
        """Wait for what the first question teaches; returns whether this is the first. Then call `learned`."""
        if self._first is None:
            self._first = asyncio.Event()
            return True
        with suppress(TimeoutError):
            async with asyncio.timeout(FIRST_S):
                await self._first.wait()
        return False

    def learned(self) -> None:
        """Let the others ask: the first question has an answer, or failed."""
        if self._first is not None:
            self._first.set()

    def refuses(self, reason: str, sent: Mapping[str, Any]) -> bool:
        """Learn from the words of a refusal; returns whether to ask once more in another form.

        `sent` holds what was sent: the names of `plain`, with `roles` and `response_format`.
        """
        if _LARGE.search(reason) or re.search(CONTEXT.words, reason, re.IGNORECASE):
            return False
        for name, words in _NAMES.items():
            if name in sent and name not in self.without and re.search(words, reason, re.IGNORECASE):
                self.without.append(name)
                logger.warning("%s refuses %s, and is asked without: %s", self.name, name, printable(reason)[:200])
                return True
        return False

    def settings(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        """The settings that are sent, by the names of the protocol: one limit of tokens has two."""
        out = {name: value for name, value in settings.items() if name not in self.without}
        limit = settings.get("max_tokens")
        if limit is not None and "max_tokens" in self.without and "max_completion_tokens" not in self.without:
            out["max_completion_tokens"] = limit
        return out

    def messages(self, messages: tuple[ChatMessage, ...]) -> tuple[ChatMessage, ...]:
        """The conversation; without `roles`, user and assistant take turns, and the user says what the system would."""
        if "roles" not in self.without:
            return messages
        joined = groupby(messages, key=lambda message: message.role == "assistant")
        return tuple(
            ChatMessage("assistant" if answers else "user", "\n\n".join(message.text for message in group))
            for answers, group in joined
        )
