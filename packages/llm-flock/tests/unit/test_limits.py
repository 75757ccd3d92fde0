"""Queue, time-outs, retries and budget, with a fake clock where time matters."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from llm_flock.errors import BudgetExceeded, ModelError, ReplayDrift
from llm_flock.llm._limits import Budget, BudgetMeter, CallLimits, Limited, RetryPolicy, Spent
from llm_flock.llm._port import Call, ChatMessage, Reply, Usage

QUESTION = Call(robot=0, round=0, kind="step", attempt=0, messages=(ChatMessage("user", "?"),))
ANSWER = Reply(text="ok", model="m:x", usage=Usage(input=30, output=10, cached=5), cost_usd=0.25)


class Scripted:
    """A model that plays a list of replies and errors, and watches how many ask at once."""

    name = "m:x"

    def __init__(self, *script: Reply | Exception, delay_s: float = 0.0) -> None:
        self.script = list(script)
        self.delay_s = delay_s
        self.asked = 0
        self.inside = 0
        self.most_inside = 0

    async def ask(self, call: Call) -> Reply:
        self.asked += 1
        self.inside += 1
        self.most_inside = max(self.most_inside, self.inside)
        try:
            await asyncio.sleep(self.delay_s)
        finally:
            self.inside -= 1
        outcome = self.script.pop(0) if self.script else ANSWER
        if isinstance(outcome, Exception):
            raise outcome
        return outcome


class FakeTime:
    """A clock that only moves while somebody sleeps on it."""

    def __init__(self) -> None:
        self.now = 0.0
        self.sleeps: list[float] = []

    def clock(self) -> float:
        return self.now

    async def sleep(self, seconds: float) -> None:
        self.sleeps.append(seconds)
        self.now += seconds
        await asyncio.sleep(0)


def limits(time: FakeTime | None = None, **options: Any) -> CallLimits:
    time = time or FakeTime()
    return CallLimits(rng=np.random.default_rng(1), clock=time.clock, sleep=time.sleep, **options)


def outcomes(model: Scripted, shared: CallLimits, calls: int = 1) -> list[Reply | BaseException]:
    async def scenario() -> Sequence[Reply | BaseException]:
        limited = Limited(model, shared)
        return await asyncio.gather(*(limited.ask(QUESTION) for _ in range(calls)), return_exceptions=True)

    return list(asyncio.run(scenario()))


def faults(*kinds: str) -> list[ModelError]:
    return [ModelError(kind, "x") for kind in kinds]


@pytest.mark.parametrize(("told_s", "latency_s"), [(0.0, 2.5), (1.5, 1.5)])
def test_time_of_a_try_is_measured_where_the_model_tells_none(told_s: float, latency_s: float) -> None:
    time = FakeTime()

    class Slow(Scripted):
        async def ask(self, call: Call) -> Reply:
            await time.sleep(2.5)
            return replace(await super().ask(call), latency_s=told_s)

    (reply,) = outcomes(Slow(), limits(time))
    assert isinstance(reply, Reply) and reply.latency_s == latency_s


def test_faults_are_retried_collected_and_counted() -> None:
    time = FakeTime()
    shared = limits(time)
    model = Scripted(*faults("server", "connection", "garbage", "timeout", "rate_limit"))
    (reply,) = outcomes(model, shared)
    assert isinstance(reply, Reply)
    assert reply.text == "ok"
    assert reply.faults == ("server", "connection", "garbage", "timeout", "rate_limit")
    assert reply.latency_s == pytest.approx(sum(time.sleeps))
    assert shared.meter.spent == Spent(calls=1, tokens=40, cost_usd=0.25)


def test_waits_double_within_their_jitter_and_stop_growing() -> None:
    time = FakeTime()
    policy = RetryPolicy(max_tries=8, first_wait_s=1.0, longest_wait_s=10.0)
    outcomes(Scripted(*faults(*["server"] * 7)), limits(time, retry=policy))
    for wait, scale in zip(time.sleeps, (1, 2, 4, 8, 10, 10, 10), strict=True):
        assert scale / 2 <= wait <= scale
    assert len(set(time.sleeps)) == 7


@pytest.mark.parametrize(("asked", "low", "high"), [(3.0, 3.0, 3.3), (60.0, 60.0, 66.0), (0.0, 0.0, 0.0)])
def test_retry_after_is_honoured(asked: float, low: float, high: float) -> None:
    time = FakeTime()
    outcomes(Scripted(ModelError("rate_limit", "x", asked)), limits(time))
    (wait,) = time.sleeps
    assert low <= wait <= high


def test_a_wait_longer_than_a_team_waits_ends_the_call() -> None:
    time = FakeTime()
    (error,) = outcomes(Scripted(ModelError("rate_limit", "x", 61.0)), limits(time))
    assert isinstance(error, ModelError) and error.retry_after_s == 61.0 and time.sleeps == []


def test_waits_that_sum_to_more_than_a_team_waits_end_the_call() -> None:
    time = FakeTime()
    (error,) = outcomes(Scripted(*[ModelError("rate_limit", "x", 25.0) for _ in range(8)]), limits(time))
    assert isinstance(error, ModelError) and len(time.sleeps) == 2 and len(error.faults) == 3


def test_the_time_out_follows_the_first_answer() -> None:
    """A server that takes 0.3 s is given 0.1 s, then 0.2, then 0.4; then it is known to be that slow."""
    shared = limits(timeout_s=0.1, patient=True)
    first, second = outcomes(Scripted(delay_s=0.3), shared, calls=2)
    assert isinstance(first, Reply) and first.faults == ("timeout", "timeout")
    assert isinstance(second, Reply) and second.faults == ("timeout", "timeout")
    assert shared.timeout_s == pytest.approx(0.4) and not shared.patient


def test_the_same_seed_waits_the_same() -> None:
    runs: list[list[float]] = []
    for _ in range(2):
        time = FakeTime()
        outcomes(Scripted(*faults("server", "server")), limits(time))
        runs.append(time.sleeps)
    assert runs[0] == runs[1]


def test_giving_up_tells_the_whole_story() -> None:
    model = Scripted(*faults(*["server"] * 9))
    (error,) = outcomes(model, limits(retry=RetryPolicy(max_tries=3)))
    assert isinstance(error, ModelError)
    assert (error.kind, error.faults, model.asked) == ("server", ("server",) * 3, 3)


def test_garbage_responses_are_retried_only_for_some_seconds() -> None:
    """A server that always sends `"choices": []` kept the whole team waiting for 46 s a question."""
    time = FakeTime()
    model = Scripted(*faults(*["garbage"] * 9))
    (error,) = outcomes(model, limits(time))
    assert isinstance(error, ModelError) and error.faults == ("garbage",) * 4 and model.asked == 4
    assert sum(time.sleeps) < 4.0
    mixed = ["garbage"] * 3 + ["server"] + ["garbage"] * 3
    (reply,) = outcomes(Scripted(*faults(*mixed)), limits())
    assert isinstance(reply, Reply) and reply.faults == tuple(mixed), "what comes between shows that it changes"


def test_an_answer_that_a_client_cannot_take_is_a_fault() -> None:
    model = Scripted(ValueError("Exceeds the limit of sk-secret"), ANSWER)
    (reply,) = outcomes(model, limits())
    assert isinstance(reply, Reply) and reply.faults == ("garbage",)
    (error,) = outcomes(Scripted(*[ValueError("sk-secret")] * 8), limits())
    assert isinstance(error, ModelError) and error.detail == "the answer ended in a ValueError"
    (error,) = outcomes(Scripted(ReplayDrift("other words")), limits())
    assert isinstance(error, ReplayDrift)


def test_a_probe_is_tried_once() -> None:
    model = Scripted(*faults("timeout", "timeout"))
    with pytest.raises(ModelError, match="timeout"):
        asyncio.run(Limited(model, limits()).ask(replace(QUESTION, probe=True)))
    assert model.asked == 1


def test_a_refusal_is_final() -> None:
    shared = limits()
    model = Scripted(*faults("server", "refused"))
    (error,) = outcomes(model, shared)
    assert isinstance(error, ModelError)
    assert (error.kind, error.faults, model.asked) == ("refused", ("server", "refused"), 2)
    assert shared.meter.spent == Spent(calls=1)


def test_no_more_than_allowed_at_once() -> None:
    model = Scripted(delay_s=0.001)
    results = outcomes(model, limits(max_concurrent=3), calls=20)
    assert model.most_inside == 3
    assert all(isinstance(result, Reply) for result in results)


def test_a_slot_is_free_while_somebody_waits_to_retry() -> None:
    """With one slot, the second call is answered while the first sits out its wait."""
    order: list[str] = []

    class Ordered(Scripted):
        async def ask(self, call: Call) -> Reply:
            order.append(f"robot {call.robot}")
            return await super().ask(call)

    async def scenario() -> None:
        model = Ordered(*faults("server"))
        shared = CallLimits(max_concurrent=1, retry=RetryPolicy(first_wait_s=0.02), rng=np.random.default_rng(0))
        limited = Limited(model, shared)
        other = Call(robot=1, round=0, kind="step", attempt=0, messages=QUESTION.messages)
        await asyncio.gather(limited.ask(QUESTION), limited.ask(other))

    asyncio.run(scenario())
    assert order == ["robot 0", "robot 1", "robot 0"]


def test_try_times_out_but_waiting_in_the_queue_does_not_count() -> None:
    async def scenario(delay_s: float, calls: int) -> list[Reply | BaseException]:
        shared = CallLimits(
            max_concurrent=1, timeout_s=0.2, retry=RetryPolicy(max_tries=1), rng=np.random.default_rng(0)
        )
        limited = Limited(Scripted(delay_s=delay_s), shared)
        return list(await asyncio.gather(*(limited.ask(QUESTION) for _ in range(calls)), return_exceptions=True))

    (late,) = asyncio.run(scenario(5.0, 1))
    assert isinstance(late, ModelError)
    assert (late.kind, late.faults) == ("timeout", ("timeout",))
    # The last of them is answered long after its time-out, had the queue counted.
    assert all(isinstance(reply, Reply) for reply in asyncio.run(scenario(0.05, 8)))


def test_cancelling_is_not_a_fault() -> None:
    async def scenario() -> None:
        model = Scripted(delay_s=5)
        task = asyncio.create_task(Limited(model, CallLimits(rng=np.random.default_rng(0))).ask(QUESTION))
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert (model.asked, model.inside) == (1, 0), "it is not asked again"

    asyncio.run(scenario())


def test_max_calls_is_never_overrun() -> None:
    shared = limits(meter=BudgetMeter(Budget(max_calls=4)))
    model = Scripted(delay_s=0.001)
    results = outcomes(model, shared, calls=10)
    assert model.asked == 4
    assert sum(isinstance(result, BudgetExceeded) for result in results) == 6
    assert shared.meter.spent.calls == 4
    assert shared.meter.reason == "max_calls = 4 is used up"


def test_a_retried_call_counts_once() -> None:
    shared = limits(meter=BudgetMeter(Budget(max_calls=1)))
    (reply,) = outcomes(Scripted(*faults("server", "server")), shared)
    assert isinstance(reply, Reply)
    assert shared.meter.spent.calls == 1 and shared.meter.reason is None


@pytest.mark.parametrize(
    ("budget", "says"), [(Budget(max_tokens=100), "max_tokens = 100"), (Budget(max_cost_usd=0.7), "max_cost = 0.7")]
)
def test_tokens_and_money_stop_calls_that_stand_in_the_queue(budget: Budget, says: str) -> None:
    shared = limits(max_concurrent=1, meter=BudgetMeter(budget))
    model = Scripted()
    results = outcomes(model, shared, calls=10)
    assert model.asked == 3  # 3 x 40 tokens, 3 x 0.25 dollars
    refused = [result for result in results if isinstance(result, BudgetExceeded)]
    assert len(refused) == 7 and all(says in str(error) for error in refused)
    # Those turned away in the queue were taken back.
    assert shared.meter.spent == Spent(calls=3, tokens=120, cost_usd=0.75)


def test_a_reply_without_a_price_adds_nothing_to_the_known_cost() -> None:
    shared = limits()
    outcomes(Scripted(replace(ANSWER, cost_usd=None), ANSWER), shared, calls=2)
    assert shared.meter.spent == Spent(calls=2, tokens=80, cost_usd=0.25)
