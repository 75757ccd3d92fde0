"""Consensus rules that break a run, importable by the workers of a pool as `rules_that_fail:NAME`."""

import asyncio
import os
import signal
from collections.abc import Sequence
from dataclasses import dataclass

from llm_flock.message import Message
from llm_flock.protocol._agreement.consensus import Standing


class Unpicklable(Exception):
    """An exception that cannot be rebuilt from its arguments, like many of libraries."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(f"{first} {second}")


@dataclass(frozen=True)
class Raising:
    """Raises in the first exchange."""

    name: str = "raising"

    def choose(self, own: Standing, heard: Sequence[Message]) -> Message | None:
        raise Unpicklable("no", "choice")


@dataclass(frozen=True)
class Cancelling:
    """Raises what asyncio raises in a cancelled task, without a cancellation."""

    name: str = "cancelling"

    def choose(self, own: Standing, heard: Sequence[Message]) -> Message | None:
        raise asyncio.CancelledError


@dataclass(frozen=True)
class Killing:
    """Kills its own process, as a machine short of memory does."""

    name: str = "killing"

    def choose(self, own: Standing, heard: Sequence[Message]) -> Message | None:
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError("still alive")
