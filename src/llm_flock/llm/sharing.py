"""What many runs share: one budget, the rates that providers allow, and connections."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections import defaultdict, deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

from llm_flock.errors import BudgetExceeded, InputError
from llm_flock.llm.limits import Budget
from llm_flock.llm.local.engine import slot_count
from llm_flock.llm.models import ModelPool
from llm_flock.llm.port import Call, Reply, Usage
from llm_flock.llm.prices import cost_usd
from llm_flock.llm.providers import known_providers

CHARS_PER_TOKEN = 4
FIRST_GUESS = 500
"""Tokens that a model is taken to answer with until it has answered for the first time."""

WINDOW_S = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Rate:
    """What one provider allows all runs together; None is without limit.

    Attributes:
        max_concurrent: calls under way at once.
        calls_per_minute: calls within any 60 s, retries included.
        tokens_per_minute: tokens in and out within any 60 s, as far as they are known before an answer is there.
    """

    max_concurrent: int | None = None
    calls_per_minute: int | None = None
    tokens_per_minute: int | None = None

    def __post_init__(self) -> None:
        for field in ("max_concurrent", "calls_per_minute", "tokens_per_minute"):
            value = getattr(self, field)
            if value is not None and value < 1:
                raise InputError(field, value, "at least 1, or not given")


@dataclass(frozen=True, slots=True, kw_only=True)
class Spent:
    """Calls, tokens in and out, and money as far as prices are known [US dollars]."""

    calls: int = 0
    tokens: int = 0
    cost_usd: float = 0.0

    def __add__(self, other: Spent) -> Spent:
        return Spent(
            calls=self.calls + other.calls, tokens=self.tokens + other.tokens, cost_usd=self.cost_usd + other.cost_usd
        )


class Gate(Protocol):
    """Lets calls of many runs through, one by one."""

    async def enter(self, model: str, call: Call, *, again: bool) -> int:
        """Wait for a turn; returns a ticket.

        Args:
            model: `provider:model` that is about to be asked.
            call: what it is asked.
            again: the call was made before and failed; it is no new one for the budget.

        Raises:
            BudgetExceeded: nothing is left for it.
        """
        ...

    def leave(self, ticket: int, reply: Reply | None) -> None:
        """The call is over; without reply, it failed."""
        ...


@dataclass(slots=True, kw_only=True)
class _Pass:
    """A call that is under way, with what it is expected to use."""

    model: str
    tokens: int
    cost_usd: float
    logged: list[float]


class _Traffic:
    """One provider's calls under way and of the last minute."""

    def __init__(self, rate: Rate, window_s: float) -> None:
        self.rate = rate
        self.queue = asyncio.Lock()
        self.under_way = 0
        self._window_s = window_s
        self._calls: deque[list[float]] = deque()
        self._tokens = 0.0

    def wait_s(self, tokens: int, now: float) -> float:
        """How long until such a call may be sent; infinite while only the end of another call helps [s]."""
        rate = self.rate
        if rate.max_concurrent is not None and self.under_way >= rate.max_concurrent:
            return float("inf")
        if rate.calls_per_minute is None and rate.tokens_per_minute is None:
            return 0.0
        while self._calls and self._calls[0][0] <= now - self._window_s:
            self._calls.popleft()
        self._tokens = sum(used for _, used in self._calls) if rate.tokens_per_minute is not None else 0.0
        full = rate.calls_per_minute is not None and len(self._calls) >= rate.calls_per_minute
        # A call that is larger than all that is allowed may go when nothing else went.
        many = rate.tokens_per_minute is not None and self._tokens + tokens > rate.tokens_per_minute
        return self._calls[0][0] + self._window_s - now if self._calls and (full or many) else 0.0

    def log(self, tokens: int, now: float) -> list[float]:
        """Note a call that is sent; the second number may be set right when more is known."""
        self.under_way += 1
        entry = [now, float(tokens)]
        if self.rate.calls_per_minute is not None or self.rate.tokens_per_minute is not None:
            self._calls.append(entry)
        return entry


class SharedGate:
    """A gate within one process and event loop.

    Calls count when they begin. Tokens and money are known when an answer is there; until then a call holds back what
    such a call is expected to use, so that near the end of a budget calls wait for those under way, and it is overrun
    by about one call.

    Args:
        budget: of all runs together.
        rates: of each provider that has any, by its name (`openai`, `simulated`, ...). The models on board, `local`,
            are asked as many questions at once as their engine answers, unless this says otherwise.
        window_s: what a minute is, for tests [s].
        clock: seconds, only differences matter.
    """

    def __init__(
        self,
        budget: Budget | None = None,
        rates: Mapping[str, Rate] | None = None,
        *,
        window_s: float = WINDOW_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        rates = {"local": Rate(max_concurrent=slot_count()), **(rates or {})}
        self.budget = budget or Budget()
        self.spent = Spent()
        self.elsewhere = Spent()
        """What other processes have spent of the same budget."""
        self.reason: str | None = None
        self._clock = clock
        self._traffic: defaultdict[str, _Traffic] = defaultdict(lambda: _Traffic(Rate(), window_s))
        for provider, rate in rates.items():
            self._traffic[provider] = _Traffic(rate, window_s)
        self._changed = asyncio.Event()
        self._tickets = itertools.count()
        self._under_way: dict[int, _Pass] = {}
        self._answers: defaultdict[str, tuple[int, int, float]] = defaultdict(lambda: (0, 0, 0.0))

    async def enter(self, model: str, call: Call, *, again: bool) -> int:
        """See `Gate`. Calls of one provider go in the order in which they came."""
        return await self.enter_sized(model, sum(len(m.text) for m in call.messages), again=again)

    async def enter_sized(self, model: str, chars: int, *, again: bool) -> int:
        """`enter` for a question of so many characters."""
        traffic = self._traffic[model.partition(":")[0]]
        tokens, cost = self._expected(model, chars)
        async with traffic.queue:
            while True:
                self._check(new=not again)
                wait = max(self._wait_for_budget(tokens, cost), traffic.wait_s(tokens, self._clock()))
                if wait <= 0:
                    break
                self._changed.clear()
                with suppress(TimeoutError):
                    async with asyncio.timeout(None if wait == float("inf") else wait):
                        await self._changed.wait()
            ticket = next(self._tickets)
            logged = traffic.log(tokens, self._clock())
            self._under_way[ticket] = _Pass(model=model, tokens=tokens, cost_usd=cost, logged=logged)
            if not again:
                self.spent += Spent(calls=1)
        return ticket

    def leave(self, ticket: int, reply: Reply | None) -> None:
        """See `Gate`."""
        usage = None if reply is None else reply.usage
        self.leave_with(ticket, usage, None if reply is None else reply.cost_usd)

    def leave_with(self, ticket: int, usage: Usage | None, cost: float | None) -> None:
        """`leave` with what the call has used."""
        found = self._under_way.pop(ticket)
        self._traffic[found.model.partition(":")[0]].under_way -= 1
        if usage is not None:
            found.logged[1] = float(usage.total)
            self.spent += Spent(tokens=usage.total, cost_usd=cost or 0.0)
            calls, output, paid = self._answers[found.model]
            self._answers[found.model] = (calls + 1, output + usage.output, paid + (cost or 0.0))
        self._changed.set()

    def told_of(self, elsewhere: Spent) -> None:
        """Take note of what other processes have spent of the same budget."""
        self.elsewhere = elsewhere

    @property
    def exhausted(self) -> bool:
        """Whether a new call would be turned away."""
        with suppress(BudgetExceeded):
            self._check(new=True)
        return self.reason is not None

    def _check(self, *, new: bool) -> None:
        spent, budget = self.spent + self.elsewhere, self.budget
        if budget.max_calls is not None and new and spent.calls >= budget.max_calls:
            self.reason = f"max_calls = {budget.max_calls} of the sweep is used up"
        elif budget.max_tokens is not None and spent.tokens >= budget.max_tokens:
            self.reason = f"max_tokens = {budget.max_tokens} of the sweep is used up ({spent.tokens} tokens)"
        elif budget.max_cost_usd is not None and spent.cost_usd >= budget.max_cost_usd:
            self.reason = (
                f"max_cost = {budget.max_cost_usd:g} of the sweep is used up ({spent.cost_usd:.4f} US dollars)"
            )
        else:
            return
        self._changed.set()
        raise BudgetExceeded(self.reason)

    def _wait_for_budget(self, tokens: int, cost: float) -> float:
        """Infinite while calls under way may use up what is left, else 0 [s]."""
        budget = self.budget
        if not self._under_way or (budget.max_tokens is None and budget.max_cost_usd is None):
            return 0.0
        spent = self.spent + self.elsewhere
        held = self._under_way.values()
        over = budget.max_tokens is not None and (
            spent.tokens + tokens + sum(p.tokens for p in held) > budget.max_tokens
        )
        over |= budget.max_cost_usd is not None and (
            spent.cost_usd + cost + sum(p.cost_usd for p in held) > budget.max_cost_usd
        )
        return float("inf") if over else 0.0

    def _expected(self, model: str, chars: int) -> tuple[int, float]:
        """Tokens and money that a call is expected to use; by list price, or as those before it."""
        calls, output, paid = self._answers[model]
        usage = Usage(input=chars // CHARS_PER_TOKEN, output=output // calls if calls else FIRST_GUESS)
        provider, _, name = model.partition(":")
        if self.budget.max_cost_usd is None:
            return usage.total, 0.0
        price_id = next((info.price_id for info in known_providers() if info.name == provider), None)
        listed = cost_usd(price_id, name, usage)
        return usage.total, listed if listed is not None else paid / max(1, calls)


class Lane:
    """One run's way to what is shared.

    Args:
        gate: lets calls through; None lets all of them.
        pools: connections; None has the run make its own.

    Attributes:
        cut: whether the shared budget turned a call of this run away.
    """

    def __init__(self, gate: Gate | None = None, pools: Pools | None = None) -> None:
        self.pools = pools
        self.cut = False
        self._gate = gate

    async def enter(self, model: str, call: Call, *, again: bool) -> int:
        """See `Gate`."""
        if self._gate is None:
            return -1
        try:
            return await self._gate.enter(model, call, again=again)
        except BudgetExceeded:
            self.cut = True
            raise

    def leave(self, ticket: int, reply: Reply | None) -> None:
        """See `Gate`."""
        if self._gate is not None:
            self._gate.leave(ticket, reply)


class Pools:
    """Connections that many runs of one event loop share."""

    def __init__(self) -> None:
        self._pools: dict[tuple[frozenset[tuple[str, str]], float], ModelPool] = {}

    def pool(self, base_urls: Mapping[str, str], timeout_s: float) -> ModelPool:
        """The pool for these addresses; `aclose` of this object closes it."""
        key = frozenset(base_urls.items()), timeout_s
        if key not in self._pools:
            self._pools[key] = ModelPool(base_urls=base_urls, timeout_s=timeout_s)
        return self._pools[key]

    async def aclose(self) -> None:
        """Close all connections."""
        for pool in self._pools.values():
            await pool.aclose()
        self._pools.clear()
