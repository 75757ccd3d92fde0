"""What a server refuses in a request though it is right, and how it is asked once more without it.

What providers are known to lack is in pydantic-ai's profiles. This is for the servers that nobody knows in advance.
"""

from __future__ import annotations

import asyncio
import logging
import re
import tomllib
from collections.abc import Mapping
from contextlib import suppress
from itertools import groupby
from pathlib import Path
from typing import Any

from llm_flock.llm._port import ChatMessage
from llm_flock.printable import printable

logger = logging.getLogger(__name__)

FIRST_S = 1.0  # longest wait for the first answer of a server, from which the others learn its dialect [s]

_WORDS = tomllib.loads(Path(__file__).with_name("server_words.toml").read_text(encoding="utf-8"))

_refused: dict[tuple[str, str], list[str]] = {}


def fault(words: str) -> Mapping[str, Any]:
    """What the words of a server's refusal mean: the `status` of HTTP, and in `advice` what to change, if it helps."""
    return next(one for one in _WORDS["fault"] if re.search(one["words"], words, re.IGNORECASE))


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

    def refuses(self, reason: str, sent: Mapping[str, Any], *, unclear: bool = False) -> bool:
        """Learn from the words of a refusal; returns whether to ask once more in another form.

        `sent` holds what was sent: the names of `plain`, with `roles` and `response_format`. A request that is refused
        as `unclear`, in words that mean nothing here, is asked once more with nothing that a server could lack.
        """
        if re.search(_WORDS["too_large"], reason, re.IGNORECASE):
            return False
        for name, words in _WORDS["left_out"].items():
            if name in sent and name not in self.without and re.search(words, reason, re.IGNORECASE):
                self.without.append(name)
                return self._says(name, reason)
        if unclear and not fault(reason)["words"] and not self.without:
            self.without.extend(sent)
            return self._says("this request", reason)
        if unclear and all(name in self.without for name in sent):
            self.without.clear()  # the plainest request is refused, too: its form is not the reason
        return False

    def _says(self, what: str, reason: str) -> bool:
        logger.warning("%s refuses %s, and is asked without: %s", self.name, what, printable(reason)[:200])
        return True

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
