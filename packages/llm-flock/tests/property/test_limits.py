"""With any behaviour of providers and any number of callers, limits hold and counters add up."""

from __future__ import annotations

import asyncio
from collections import Counter

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from llm_flock.errors import BudgetExceeded, InputError, ModelError
from llm_flock.llm._limits import Budget, BudgetMeter, CallLimits, Limited, RetryPolicy
from llm_flock.llm._models import per_robot
from llm_flock.llm._port import Call, ChatMessage, Reply, Usage

QUESTION = Call(robot=0, round=0, kind="step", attempt=0, messages=(ChatMessage("user", "?"),))
KINDS = ("ok", "ok", "server", "rate_limit", "timeout", "connection", "garbage", "refused")


class Provider:
    """Does what a list of words says, one for each try, then answers everything."""

    name = "m:x"

    def __init__(self, script: list[str]) -> None:
        self.script = list(reversed(script))
        self.inside = self.most_inside = self.tries = 0

    async def ask(self, call: Call) -> Reply:
        self.tries += 1
        self.inside += 1
        self.most_inside = max(self.most_inside, self.inside)
        await asyncio.sleep(0)
        self.inside -= 1
        kind = self.script.pop() if self.script else "ok"
        if kind != "ok":
            raise ModelError(kind, "x")
        return Reply(text="ok", model="m:x", usage=Usage(input=3, output=2))


@given(
    script=st.lists(st.sampled_from(KINDS), max_size=40),
    calls=st.integers(1, 20),
    at_once=st.integers(1, 6),
    max_calls=st.none() | st.integers(1, 20),
    max_tokens=st.none() | st.integers(1, 60),
    max_tries=st.integers(1, 5),
)
def test_limits_hold_and_counters_add_up(
    script: list[str], calls: int, at_once: int, max_calls: int | None, max_tokens: int | None, max_tries: int
) -> None:
    meter = BudgetMeter(Budget(max_calls=max_calls, max_tokens=max_tokens))
    provider = Provider(script)

    async def no_wait(seconds: float) -> None:
        assert 0 <= seconds <= 30
        await asyncio.sleep(0)

    async def scenario() -> list[Reply | BaseException]:
        limits = CallLimits(
            max_concurrent=at_once,
            retry=RetryPolicy(max_tries=max_tries),
            meter=meter,
            rng=np.random.default_rng(0),
            sleep=no_wait,
        )
        limited = Limited(provider, limits)
        return list(await asyncio.gather(*(limited.ask(QUESTION) for _ in range(calls)), return_exceptions=True))

    results = asyncio.run(scenario())
    replies = [result for result in results if isinstance(result, Reply)]
    errors = [result for result in results if isinstance(result, ModelError)]
    assert len(replies) + len(errors) == calls
    assert provider.most_inside <= at_once
    assert meter.spent.calls <= (max_calls or calls)
    assert meter.spent.tokens == 5 * len(replies)
    if max_tokens is not None:
        assert meter.spent.tokens < max_tokens + 5 * at_once  # only what was under way may overrun
    met = Counter(fault for result in replies + errors for fault in result.faults)
    assert met == Counter(kind for kind in script[: provider.tries] if kind != "ok")
    never_sent = [error for error in errors if isinstance(error, BudgetExceeded) and not error.faults]
    assert meter.spent.calls == calls - len(never_sent)
    assert (meter.reason is not None) == any(isinstance(error, BudgetExceeded) for error in errors)


@given(
    cuts=st.lists(st.integers(1, 5), min_size=1, max_size=6),
    values=st.lists(st.text("ab:,@. ", min_size=1).filter(str.strip), min_size=6, max_size=6),
    order=st.randoms(use_true_random=False),
)
def test_ranges_give_every_robot_its_own_value(cuts: list[int], values: list[str], order) -> None:
    parts: list[str] = []
    expected: list[str] = []
    for length, value in zip(cuts, values, strict=False):
        parts.append(f"{len(expected)}-{len(expected) + length - 1}={value}")
        expected += [value.strip()] * length
    order.shuffle(parts)
    assert per_robot("model", ",".join(parts), len(expected)) == tuple(expected)


@given(text=st.text("0123456789-=,a ", max_size=20), n=st.integers(1, 5))
def test_any_text_gives_n_values_or_a_clear_error(text: str, n: int) -> None:
    try:
        values = per_robot("model", text, n)
    except InputError:
        return  # and nothing else
    assert len(values) == n
