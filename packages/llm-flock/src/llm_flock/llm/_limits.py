"""Queue, time-outs, retries and budget between the robots of one run and a provider."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Protocol

import msgspec
import numpy as np

from llm_flock.bounds import MAX_INTEGER
from llm_flock.errors import BudgetExceeded, FlockError, ModelError
from llm_flock.llm._port import Call, LanguageModel, Reply, Usage

if TYPE_CHECKING:
    from llm_flock.llm._models import ModelPool

logger = logging.getLogger(__name__)


LONGEST_S = 600.0  # longest time-out to which a first answer is waited for, unless the operator says how long [s]


@dataclass(frozen=True, slots=True, kw_only=True)
class RetryPolicy:
    """When to ask again after a fault, in up to `max_tries` attempts.

    The wait before attempt k (k = 2, 3, ...) is drawn uniformly from the upper half of [0, first_wait_s * 2^(k-2)], at
    most longest_wait_s, so that robots that were turned away together do not return together. A wait by Retry-After is
    kept in full, with up to a tenth on top; if those of a call sum to more than longest_retry_after_s, it ends at once.

    `max_garbage` responses in a row that are not of the protocol end the call: such a server is neither busy nor away.
    """

    max_tries: int = 8
    max_garbage: int = 4
    first_wait_s: float = 0.5
    longest_wait_s: float = 30.0
    longest_retry_after_s: float = 60.0

    def gives_up(self, faults: tuple[str, ...], asked_s: float = 0.0) -> bool:
        """Whether another attempt is useless, by the kinds of all faults of a call and the waits asked for [s]."""
        if asked_s > self.longest_retry_after_s:
            return True
        return len(faults) >= self.max_tries or faults[-self.max_garbage :] == ("garbage",) * self.max_garbage

    def wait_s(self, failed: int, retry_after_s: float | None, rng: np.random.Generator) -> float:
        """Draw the wait before the next attempt, after `failed` >= 1 failed ones [s]."""
        if retry_after_s is not None:
            return retry_after_s * rng.uniform(1.0, 1.1)
        # 2.0 ** 40 is longer than any useful longest_wait_s, and does not overflow.
        scale = min(self.first_wait_s * 2.0 ** min(failed - 1, 40), self.longest_wait_s)
        return scale * rng.uniform(0.5, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Spent:
    """Calls, tokens in and out, and money where prices are known [US dollars]."""

    calls: Annotated[int, msgspec.Meta(ge=0, le=MAX_INTEGER)] = 0
    tokens: Annotated[int, msgspec.Meta(ge=0, le=MAX_INTEGER)] = 0
    cost_usd: Annotated[float, msgspec.Meta(ge=0.0, le=1e12)] = 0.0

    def __add__(self, other: Spent) -> Spent:
        return Spent(
            calls=self.calls + other.calls, tokens=self.tokens + other.tokens, cost_usd=self.cost_usd + other.cost_usd
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """Limits of one run or one sweep, checked where they are read; None is no limit.

    A retried call counts once. Tokens are input and output together; money counts where prices are known.
    """

    max_calls: int | None = None
    max_tokens: int | None = None
    max_cost_usd: float | None = None


class BudgetMeter:
    """Counts calls, tokens and money, and enforces a budget.

    Calls are counted when they begin, so that concurrent calls cannot overrun `max_calls`. Tokens and money are known
    only with the answer: calls under way at that moment may overrun those two.

    Attributes:
        elsewhere: spent by other processes of the same budget, as set by the owner of this meter.
        reason: the limit that turned a call away, None so far.
    """

    owner = ""

    def __init__(self, budget: Budget | None = None) -> None:
        self.budget = budget or Budget()
        self.spent: Spent = Spent()
        self.elsewhere: Spent = Spent()
        self.reason: str | None = None

    def check(self, *, new_call: bool) -> None:
        """Raise BudgetExceeded when a limit is reached by the replies so far; a retry is not a `new_call`."""
        limits, spent = self.budget, self.spent + self.elsewhere
        if limits.max_tokens is not None and spent.tokens >= limits.max_tokens:
            self.reason = f"max_tokens = {limits.max_tokens}{self.owner} is used up ({spent.tokens} tokens)"
        elif limits.max_cost_usd is not None and spent.cost_usd >= limits.max_cost_usd:
            paid = f"{spent.cost_usd:.4f} US dollars"
            self.reason = f"max_cost = {limits.max_cost_usd:g}{self.owner} is used up ({paid})"
        elif new_call and limits.max_calls is not None and spent.calls >= limits.max_calls:
            self.reason = f"max_calls = {limits.max_calls}{self.owner} is used up"
        else:
            return
        raise BudgetExceeded(self.reason)


class CallGate(Protocol):
    """Admits calls of many runs one by one; see `sharing.SharedGate`."""

    async def enter(self, model: str, chars: int, *, again: bool) -> int:
        """Wait for a turn to ask `provider:model` a question of `chars` characters; returns a ticket for `leave`.

        A call that failed before (`again`) is not counted again. BudgetExceeded if the budget is used up.
        """
        ...

    def leave(self, ticket: int, usage: Usage | None, cost_usd: float | None) -> None:
        """End the call; without usage, it failed."""
        ...


@dataclass(slots=True)
class CallLane:
    """One run's access to the gate and the models that it shares with other runs."""

    gate: CallGate | None = None  #: Admits calls of this run and others; None admits all.
    pool: ModelPool | None = None  #: Makes the models; without it, the run makes its own.
    cut: bool = False  #: Whether the gate turned away a call of this run.


@dataclass(slots=True, kw_only=True)
class CallLimits:
    """Limits that all models of one run share. Build one for each run, in the thread of its event loop."""

    rng: np.random.Generator  #: Chance for the jitter of waits.
    max_concurrent: int = 256  #: Calls under way at once; `slots` holds as many.
    timeout_s: float = 120.0  #: Longest attempt, without the queue [s].
    patient: bool = False  #: Whether the time-out doubles, up to LONGEST_S, until there is a first answer.
    retry: RetryPolicy = field(default_factory=RetryPolicy)
    meter: BudgetMeter = field(default_factory=BudgetMeter)
    lane: CallLane = field(default_factory=CallLane)
    clock: Callable[[], float] = time.perf_counter
    sleep: Callable[[float], Awaitable[None]] = asyncio.sleep
    slots: asyncio.Semaphore = field(init=False)

    def __post_init__(self) -> None:
        self.slots = asyncio.Semaphore(self.max_concurrent)

    def note_late(self, allowed_s: float) -> None:
        """There was no answer within this time, which others may have noted already [s]."""
        if self.patient and allowed_s == self.timeout_s < LONGEST_S:
            self.timeout_s = min(2.0 * allowed_s, LONGEST_S)
            logger.warning("no model answered within %g s: they now have %g s", allowed_s, self.timeout_s)


class Limited:
    """A `LanguageModel` that queues, times out, retries and counts the calls of another one."""

    def __init__(self, model: LanguageModel, limits: CallLimits) -> None:
        self.name = model.name
        self._model = model
        self._limits = limits

    async def ask(self, call: Call) -> Reply:
        """Answer one call, and retry faults. Without an answer: BudgetExceeded, or the last ModelError with all faults.

        The latency runs from the first attempt to the answer, without the queue. The reply has the retried faults. A
        probe is tried once: a model that never answers must not hold up the team.
        """
        limits, lane = self._limits, self._limits.lane
        limits.meter.check(new_call=True)
        limits.meter.spent += Spent(calls=1)
        faults: tuple[str, ...] = ()
        started: float | None = None
        asked_s = 0.0
        while True:
            async with limits.slots:
                ticket: int | None = None
                try:
                    # Other calls may have used up the budget while this one was in the queue.
                    limits.meter.check(new_call=False)
                    if lane.gate is not None:
                        chars = sum(len(message.text) for message in call.messages)
                        ticket = await lane.gate.enter(self.name, chars, again=bool(faults))
                except BudgetExceeded as error:
                    lane.cut |= error.detail != limits.meter.reason  # then the gate turned it away
                    if not faults:
                        limits.meter.spent += Spent(calls=-1)  # it was never sent
                    error.faults = faults
                    raise
                if started is None:
                    started = limits.clock()
                outcome: Reply | ModelError | None = None
                allowed_s = limits.timeout_s
                try:
                    async with asyncio.timeout(allowed_s):
                        outcome = await self._model.ask(call)
                except ModelError as error:  # its wait happens outside the slot
                    outcome = error
                except TimeoutError:
                    outcome = ModelError("timeout", f"no answer within {allowed_s:g} s")
                    limits.note_late(allowed_s)
                except FlockError:
                    raise
                except Exception as error:  # noqa: BLE001 - an answer that a client cannot take; its text may hold a key
                    outcome = ModelError("garbage", f"the answer ended in a {type(error).__name__}")
                finally:
                    if lane.gate is not None and ticket is not None:
                        used = (outcome.usage, outcome.cost_usd) if isinstance(outcome, Reply) else (None, None)
                        lane.gate.leave(ticket, *used)
            if isinstance(outcome, Reply):
                limits.patient = False
                limits.meter.spent += Spent(tokens=outcome.usage.total, cost_usd=outcome.cost_usd or 0.0)
                if not faults and outcome.latency_s:
                    return outcome  # a single attempt, timed by the model
                return replace(outcome, faults=faults + outcome.faults, latency_s=limits.clock() - started)
            faults += outcome.faults or (outcome.kind,)
            asked_s += outcome.retry_after_s or 0.0
            if call.probe or outcome.kind in ("refused", "budget") or limits.retry.gives_up(faults, asked_s):
                outcome.faults = faults
                raise outcome
            await limits.sleep(limits.retry.wait_s(len(faults), outcome.retry_after_s, limits.rng))
