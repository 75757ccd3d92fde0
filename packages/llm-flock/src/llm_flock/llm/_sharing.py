"""A budget and the rates of providers that the runs of a sweep share."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections import defaultdict, deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field

from llm_flock import plugins
from llm_flock.errors import BudgetExceeded
from llm_flock.llm._limits import Budget, BudgetMeter, Spent
from llm_flock.llm._port import Usage
from llm_flock.llm._providers import cost_usd, source_of

CHARS_PER_TOKEN = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Rate:
    """Limits of a provider for all runs together, checked where they are read; None is no limit.

    A minute is any 60 s. Retries count as calls; calls under way count with their expected tokens, in and out.
    """

    max_concurrent: int | None = None
    calls_per_minute: int | None = None
    tokens_per_minute: int | None = None


@dataclass(slots=True, eq=False)
class _SentCall:
    """A call that was sent; until it ends, tokens and money are expected values."""

    model: str
    tokens: int
    cost_usd: float
    at_s: float


@dataclass(slots=True)
class _Traffic:
    """Calls of one provider: the number under way and the list of the last minute."""

    rate: Rate
    window_s: float
    queue: asyncio.Lock = field(default_factory=asyncio.Lock)
    under_way: int = 0
    recent: deque[_SentCall] = field(default_factory=deque[_SentCall])

    def wait_s(self, tokens: int, now: float) -> float:
        """Wait before a call of this size may be sent [s]; infinite until another call ends."""
        rate, recent = self.rate, self.recent
        if rate.max_concurrent is not None and self.under_way >= rate.max_concurrent:
            return float("inf")
        while recent and recent[0].at_s <= now - self.window_s:
            recent.popleft()
        full = rate.calls_per_minute is not None and len(recent) >= rate.calls_per_minute
        if not full and rate.tokens_per_minute is not None:
            full = sum(call.tokens for call in recent) + tokens > rate.tokens_per_minute
        # A call larger than the whole limit may go when no other call counts.
        return recent[0].at_s + self.window_s - now if recent and full else 0.0

    def sent(self, call: _SentCall) -> None:
        """Count a call."""
        self.under_way += 1
        if self.rate.calls_per_minute is not None or self.rate.tokens_per_minute is not None:
            self.recent.append(call)


class SharedGate(BudgetMeter):
    """A `CallGate` within one process and event loop.

    Calls count when they begin. Tokens and money are known with the answer; until then a call reserves its expected
    use. Near the end of a budget, calls wait for those under way, so it is overrun by about one call.

    `rates` maps names of providers (`openai`, `simulated`, ...) to limits. A plug-in's models default to the number of
    questions that they answer at the same time. `window_s` is the length of a minute, for tests [s].
    """

    owner = " of the sweep"

    def __init__(
        self, budget: Budget | None = None, rates: Mapping[str, Rate] | None = None, *, window_s: float = 60.0
    ) -> None:
        super().__init__(budget)
        given = rates or {}
        self._traffic: defaultdict[str, _Traffic] = defaultdict(lambda: _Traffic(Rate(), window_s))
        for provider in {*plugins.entries("models"), *given}:
            rate = given.get(provider) or Rate(max_concurrent=source_of(provider).at_once)
            self._traffic[provider] = _Traffic(rate, window_s)
        self._changed = asyncio.Event()
        self._tickets = itertools.count()
        self._under_way: dict[int, _SentCall] = {}
        self._answers: defaultdict[str, tuple[int, int, float]] = defaultdict(lambda: (0, 0, 0.0))

    async def enter(self, model: str, chars: int, *, again: bool) -> int:
        """See `CallGate`. Calls of one provider go first come, first served."""
        traffic = self._traffic[model.partition(":")[0]]
        tokens, cost = self._expected(model, chars)
        async with traffic.queue:
            while True:
                self.check(new_call=not again)
                wait = max(self._wait_for_budget(tokens, cost), traffic.wait_s(tokens, time.monotonic()))
                if wait <= 0:
                    break
                self._changed.clear()
                with suppress(TimeoutError):
                    async with asyncio.timeout(None if wait == float("inf") else wait):
                        await self._changed.wait()
            ticket = next(self._tickets)
            self._under_way[ticket] = call = _SentCall(model, tokens, cost, time.monotonic())
            traffic.sent(call)
            if not again:
                self.spent += Spent(calls=1)
        return ticket

    def leave(self, ticket: int, usage: Usage | None, cost_usd: float | None) -> None:
        """See `CallGate`."""
        call = self._under_way.pop(ticket)
        self._traffic[call.model.partition(":")[0]].under_way -= 1
        if usage is not None:
            call.tokens = usage.total
            self.spent += Spent(tokens=usage.total, cost_usd=cost_usd or 0.0)
            calls, output, paid = self._answers[call.model]
            self._answers[call.model] = (calls + 1, output + usage.output, paid + (cost_usd or 0.0))
        self._changed.set()

    @property
    def exhausted(self) -> bool:
        """Whether a new call would be turned away."""
        with suppress(BudgetExceeded):
            self.check(new_call=True)
        return self.reason is not None

    def _wait_for_budget(self, tokens: int, cost: float) -> float:
        """Infinite while calls under way may use up the rest of the budget, else 0 [s]."""
        budget, calls = self.budget, self._under_way.values()
        if not calls or (budget.max_tokens is None and budget.max_cost_usd is None):
            return 0.0
        tokens += self.spent.tokens + self.elsewhere.tokens + sum(call.tokens for call in calls)
        cost += self.spent.cost_usd + self.elsewhere.cost_usd + sum(call.cost_usd for call in calls)
        over = budget.max_tokens is not None and tokens > budget.max_tokens
        over |= budget.max_cost_usd is not None and cost > budget.max_cost_usd
        return float("inf") if over else 0.0

    def _expected(self, model: str, chars: int) -> tuple[int, float]:
        """Expected tokens and money of a call: by list price, or as the mean of earlier calls."""
        calls, output, paid = self._answers[model]
        # The expected length is the mean of earlier answers; for the first one, 500 tokens.
        usage = Usage(input=chars // CHARS_PER_TOKEN, output=output // calls if calls else 500)
        provider, _, name = model.partition(":")
        if self.budget.max_cost_usd is None:
            return usage.total, 0.0
        listed = cost_usd(provider, name, usage)
        return usage.total, listed if listed is not None else paid / max(1, calls)
