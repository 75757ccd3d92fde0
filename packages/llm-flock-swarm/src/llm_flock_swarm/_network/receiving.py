"""Decodes received messages, and counts those that are rejected."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Generator
from contextlib import contextmanager

from llm_flock.errors import MessageError
from llm_flock_swarm._network.wire import T, unpack
from llm_flock_swarm._zenoh import ZenohLink

logger = logging.getLogger(__name__)

INTERNAL_ERROR = "fault"  # reason that counts input on which this program failed
MAX_LOGGED_FAULTS = 3  # a flood of faults must not fill the disk


def receive(
    link: ZenohLink,
    kind: str,
    message: type[T],
    handler: Callable[[int, T], None],
    *,
    number: int | None = None,
    sender: int | None = None,
) -> None:
    """Call `handler(sender, message)` in the event loop for every message of a kind.

    With a `number`, only messages to this id count, on a topic that belongs to its receiver; with a `sender`, only its
    own. Messages that cannot be decoded or handled are counted: none ends the process.
    """

    def take(source: int, payload: bytes) -> None:
        if sender not in (None, source):
            return
        with count_refusals(link.traffic.refused):
            handler(source, unpack(message, payload))

    link.listen(kind, number, take)


@contextmanager
def count_refusals(refused: Counter[str]) -> Generator[None]:
    """Count errors raised inside as refused input, instead of raising them."""
    try:
        yield
    except MessageError as error:
        refused[error.reason] += 1
    except Exception as error:
        refused[INTERNAL_ERROR] += 1
        if refused[INTERNAL_ERROR] <= MAX_LOGGED_FAULTS:
            logger.warning("input dropped: %s: %s", type(error).__name__, error, exc_info=error)
