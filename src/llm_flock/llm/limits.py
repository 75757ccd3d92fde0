"""What stands between robots and a provider: a queue, time-outs, patience with faults, and the run's budget."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from llm_flock.errors import BudgetExceeded, InputError, ModelError
from llm_flock.llm.port import Call, LanguageModel, Reply, Usage

if TYPE_CHECKING:
    from llm_flock.llm.sharing import Gate

FINAL = frozenset({"refused", "budget"})
"""Kinds of ModelError that asking again cannot cure."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RetryPolicy:
    """How patiently a fault is met.

    The wait before try k (k = 2, 3, ...) is drawn uniformly from the upper half of [0, first_wait_s * 2^(k-2)], at
    most longest_wait_s: robots that were all turned away at once do not come back all at once. What the provider
    asks for by Retry-After is waited for in full, up to longest_retry_after_s, with up to a tenth on top.

    Attributes:
        max_tries: tries for one call, the first included.
        first_wait_s: scale of the first wait [s].
        longest_wait_s: longest wait of our own choice [s].
        longest_retry_after_s: longest wait on the provider's word [s].
    """

    max_tries: int = 8
    first_wait_s: float = 0.5
    longest_wait_s: float = 30.0
    longest_retry_after_s: float = 60.0

    def __post_init__(self) -> None:
        if self.max_tries < 1:
            raise InputError("max_tries", self.max_tries, "at least 1")
        for name in ("first_wait_s", "longest_wait_s", "longest_retry_after_s"):
            if not 0 <= getattr(self, name) < float("inf"):
                raise InputError(name, getattr(self, name), "a number of seconds, at least 0")

    def wait_s(self, failed: int, retry_after_s: float | None, rng: np.random.Generator) -> float:
        """Wait before the next try.

        Args:
            failed: tries that have failed so far, at least 1.
            retry_after_s: what the provider asked for, None where it did not [s].
            rng: chance.

        Returns:
            Seconds.
        """
        if retry_after_s is not None:
            return min(retry_after_s, self.longest_retry_after_s) * rng.uniform(1.0, 1.1)
        # 2.0 ** 40 is longer than any longest_wait_s that makes sense, and never overflows.
        scale = min(self.first_wait_s * 2.0 ** min(failed - 1, 40), self.longest_wait_s)
        return scale * rng.uniform(0.5, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """What one run may use; None is without limit.

    Attributes:
        max_calls: questions put to models (a retried call counts once).
        max_tokens: input and output together.
        max_cost_usd: money [US dollars], as far as prices are known.
    """

    max_calls: int | None = None
    max_tokens: int | None = None
    max_cost_usd: float | None = None

    def __post_init__(self) -> None:
        for field, value in (("max_calls", self.max_calls), ("max_tokens", self.max_tokens)):
            if value is not None and value < 1:
                raise InputError(field, value, "at least 1, or not given")
        if self.max_cost_usd is not None and not 0 < self.max_cost_usd < float("inf"):
            raise InputError("max_cost", self.max_cost_usd, "more than 0, or not given")


class BudgetMeter:
    """Counts what a run has used, and says when that is enough.

    Calls are counted when they begin, so that many at once cannot overrun `max_calls`. Tokens and money are known
    only when an answer is there: calls that are under way at that moment may overrun those two.

    Attributes:
        calls: calls begun.
        answered: calls that got a reply.
        usage: tokens of all replies.
        known_cost_usd: sum of the known prices [US dollars].
        faults: how often each kind of fault was met, retried or not.
        reason: which limit ended it, None while none has.
    """

    def __init__(self, budget: Budget | None = None) -> None:
        self.budget = budget or Budget()
        self.calls = 0
        self.answered = 0
        self.usage = Usage()
        self.known_cost_usd = 0.0
        self.faults: Counter[str] = Counter()
        self.reason: str | None = None

    @property
    def exhausted(self) -> bool:
        """Whether a call was, or would now be, turned away."""
        return self.reason is not None

    def reserve(self) -> None:
        """Count a call that is about to begin.

        Raises:
            BudgetExceeded: nothing is left for it; it is not counted.
        """
        self.check()
        if self.budget.max_calls is not None and self.calls >= self.budget.max_calls:
            self._stop(f"max_calls = {self.budget.max_calls} is used up")
        self.calls += 1

    def check(self) -> None:
        """Raise BudgetExceeded when tokens or money are used up, as far as replies have told."""
        tokens, cost = self.budget.max_tokens, self.budget.max_cost_usd
        if tokens is not None and self.usage.total >= tokens:
            self._stop(f"max_tokens = {tokens} is used up ({self.usage.total} tokens)")
        if cost is not None and self.known_cost_usd >= cost:
            self._stop(f"max_cost = {cost:g} is used up ({self.known_cost_usd:.4f} US dollars)")

    def _stop(self, reason: str) -> None:
        self.reason = reason
        raise BudgetExceeded(reason)

    def release(self) -> None:
        """Take back a reserved call that was never sent."""
        self.calls -= 1

    def settle(self, reply: Reply) -> None:
        """Count what came back."""
        self.answered += 1
        self.usage += reply.usage
        if reply.cost_usd is not None:
            self.known_cost_usd += reply.cost_usd


class Limits:
    """What all models of one run share. Build it inside the event loop's thread, one for each run.

    Args:
        max_concurrent: calls under way at once.
        timeout_s: longest try, from the moment it is sent; the queue does not count [s].
        retry: how patiently faults are met.
        meter: the run's budget and counters.
        gate: what this run shares with others; None for nothing.
        rng: chance for the jitter of waits.
        clock: seconds, only differences matter.
        sleep: waits that many seconds.
    """

    def __init__(
        self,
        *,
        max_concurrent: int = 256,
        timeout_s: float = 120.0,
        retry: RetryPolicy | None = None,
        meter: BudgetMeter | None = None,
        gate: Gate | None = None,
        rng: np.random.Generator,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        if max_concurrent < 1:
            raise InputError("max_concurrent", max_concurrent, "at least 1")
        if not 0 < timeout_s < float("inf"):
            raise InputError("timeout_s", timeout_s, "a number of seconds, more than 0")
        self.slots = asyncio.Semaphore(max_concurrent)
        self.timeout_s = timeout_s
        self.retry = retry or RetryPolicy()
        self.meter = meter or BudgetMeter()
        self.gate = gate
        self.rng = rng
        self.clock = clock
        self.sleep = sleep


class Limited:
    """A `LanguageModel` that queues, times out, retries and counts on behalf of the model inside."""

    def __init__(self, model: LanguageModel, limits: Limits) -> None:
        self._model = model
        self._limits = limits

    @property
    def name(self) -> str:
        """The name of the model inside."""
        return self._model.name

    async def ask(self, call: Call) -> Reply:
        """Answer one call, however many tries that takes.

        The reply's latency runs from the first try to the answer, waits between tries included and the queue before
        the first one not; its faults are those that were met on the way.

        Raises:
            BudgetExceeded: the run's budget is used up; nothing more was sent.
            ModelError: the last fault, with all of them in `faults`.
        """
        limits = self._limits
        limits.meter.reserve()
        faults: tuple[str, ...] = ()
        started: float | None = None
        while True:
            async with limits.slots:
                ticket: int | None = None
                try:
                    # Much may have been spent while this call stood in the queue.
                    limits.meter.check()
                    if limits.gate is not None:
                        ticket = await limits.gate.enter(self.name, call, again=bool(faults))
                except BudgetExceeded as error:
                    if not faults:
                        limits.meter.release()
                    error.faults = faults
                    raise
                if started is None:
                    started = limits.clock()
                outcome: Reply | ModelError | None = None
                try:
                    outcome = await self._try(call)
                finally:
                    if limits.gate is not None and ticket is not None:
                        limits.gate.leave(ticket, outcome if isinstance(outcome, Reply) else None)
            if isinstance(outcome, Reply):
                limits.meter.settle(outcome)
                if not faults and outcome.latency_s:
                    return outcome  # a single try, whose duration the model has told itself
                return replace(outcome, faults=faults + outcome.faults, latency_s=limits.clock() - started)
            faults += outcome.faults or (outcome.kind,)
            limits.meter.faults.update(outcome.faults or (outcome.kind,))
            if outcome.kind in FINAL or len(faults) >= limits.retry.max_tries:
                outcome.faults = faults
                raise outcome
            await limits.sleep(limits.retry.wait_s(len(faults), outcome.retry_after_s, limits.rng))

    async def _try(self, call: Call) -> Reply | ModelError:
        """One try; a fault is returned, because what follows it happens outside the slot."""
        limits = self._limits
        try:
            async with asyncio.timeout(limits.timeout_s):
                return await self._model.ask(call)
        except ModelError as error:
            return error
        except TimeoutError:
            return ModelError("timeout", f"no answer within {limits.timeout_s:g} s")


class Metered:
    """A `LanguageModel` that only counts: for cassettes, whose faults, waits and refusals are already recorded."""

    def __init__(self, model: LanguageModel, meter: BudgetMeter) -> None:
        self._model = model
        self._meter = meter

    @property
    def name(self) -> str:
        """The name of the model inside."""
        return self._model.name

    async def ask(self, call: Call) -> Reply:
        """Pass the call on and count what comes back, as the recorded run counted it.

        Raises:
            ModelError: as the model inside.
        """
        try:
            reply = await self._model.ask(call)
        except ModelError as error:
            self._meter.faults.update(error.faults)
            if isinstance(error, BudgetExceeded):
                self._meter.reason = error.detail
            if error.faults or not isinstance(error, BudgetExceeded):
                self._meter.calls += 1  # it was sent at least once
            raise
        self._meter.calls += 1
        self._meter.faults.update(reply.faults)
        self._meter.settle(reply)
        return reply
