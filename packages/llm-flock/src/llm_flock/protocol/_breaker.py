"""The circuit breaker between a robot and its model. It stops questions to a model whose answers stay unusable.

The pattern is Nygard's (Release It!, 2007). While the breaker is open, geometry answers. While it is half-open, one
question without retries is a probe: a usable answer closes the breaker, another failure opens it for twice as long.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Literal, TypeAlias

from llm_flock.events import Note
from llm_flock.planner import NoAnswer

Fallback: TypeAlias = Literal["breaker", "hold", "geometry"]
"""Without a usable answer a robot uses a `CircuitBreaker`, holds its position, or always answers by geometry."""

QuestionKind: TypeAlias = Literal["plan", "step"]

THRESHOLD = 2  # failed questions in a row, each with its retries, that open a closed breaker
RECOVERY = 0.25  # failures that a usable answer makes up for
FIRST_WAIT = 2  # rounds from the opening of a breaker to the first probe; each failed probe doubles the wait
MAX_WAIT_ROUNDS = 64  # longest wait for a probe [rounds]


class BreakerState(StrEnum):
    CLOSED = "closed"
    OPEN = "open"
    HALF_OPEN = "half_open"


class CircuitBreaker:
    """Decides whether a robot asks its model; call `asks` before each question, and `usable` or `refused` after it."""

    def __init__(self, question: QuestionKind, *, enabled: bool) -> None:
        self.state = BreakerState.CLOSED
        self.refusals = 0  # failed questions since the last usable answer
        self.reason: NoAnswer | None = None  # of the last one
        self._question, self._enabled = question, enabled
        self._wait = FIRST_WAIT
        self._due = 0
        self._doubted = False
        self._score = 0.0  # failures, less those that usable answers have made up for

    @property
    def is_open(self) -> bool:
        """Whether geometry answers for the model, now or unless the probe under way succeeds."""
        return self.state is not BreakerState.CLOSED

    def asks(self, number: int) -> bool:
        """Whether to ask the model in this round; the question is a probe if the breaker is half-open then."""
        if self.state is BreakerState.OPEN and number >= self._due:
            self.state = BreakerState.HALF_OPEN
        return self.state is not BreakerState.OPEN

    def begin_mission(self) -> None:
        """Another mission, with other questions: forget the failures, and if the breaker is open, probe at once."""
        self.refusals, self._due, self._score = 0, 0, 0.0

    def usable(self) -> list[Note]:
        """The model's answer could be used. Returns a note if that closes the breaker."""
        closes = self.is_open
        self.state = BreakerState.CLOSED
        # A model that has just recovered is doubted until its second good answer: one failure opens the breaker again.
        self._doubted = closes
        if not closes:
            self._wait = FIRST_WAIT
        self.refusals, self.reason = 0, None
        self._score = 0.0 if closes else max(0.0, self._score - RECOVERY)
        return [self._note(None, "")] if closes else []

    def refused(self, number: int, answer: NoAnswer) -> list[Note]:
        """The model's answer to a question of this round is unusable. Returns a note if the breaker is open now."""
        self.refusals += 1
        self._score += 1.0
        self.reason = answer
        if not self._enabled:
            return []
        if self.state is BreakerState.HALF_OPEN or (self._doubted and not self.is_open):
            self._wait = min(2 * self._wait, MAX_WAIT_ROUNDS)
        elif self._score < THRESHOLD:
            return []
        self.state, self._doubted = BreakerState.OPEN, False
        self._due = number + self._wait
        return [self._note(self._wait, answer.reason)]

    def _note(self, wait: int | None, reason: str) -> Note:
        detail = {"question": self._question, "state": self.state.value, "refusals": self.refusals}
        return Note("breaker", {**detail, "wait": wait, "reason": reason})


def fallback_notes(question: str, by: str, failure: NoAnswer | None) -> list[Note]:
    """A note that geometry or a neighbour's plan replaced a planner's answer; empty if the planner did not fail."""
    if failure is None:
        return []
    return [Note("fallback", {"question": question, "by": by, "cause": failure.cause, "reason": failure.reason})]
