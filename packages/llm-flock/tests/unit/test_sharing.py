"""What many runs share: a budget that holds for all, and rates that no minute exceeds."""

import asyncio
import time

import pytest

from llm_flock.errors import BudgetExceeded
from llm_flock.llm._limits import Budget, BudgetMeter, CallLane, CallLimits, Limited, Spent
from llm_flock.llm._port import Call, ChatMessage, Reply, Usage
from llm_flock.llm._sharing import Rate, SharedGate
from llm_flock.runtime._schedule import Stream, stream

CALL = Call(robot=0, round=1, kind="step", attempt=0, messages=(ChatMessage("user", "x" * 400),))
CHARS = 400
USED = Usage(input=60, output=40)
REPLY = Reply(text="", model="simulated:ideal", usage=USED, cost_usd=1.0)


async def once(gate: SharedGate, model: str = "simulated:ideal", hold_s: float = 0.0) -> float:
    ticket = await gate.enter(model, CHARS, again=False)
    # The gate's own time: a pause of the process between the gate and here would make a window look shorter.
    sent = gate._under_way[ticket].at_s
    assert time.monotonic() - 60 < sent <= time.monotonic()
    await asyncio.sleep(hold_s)
    gate.leave(ticket, USED, 1.0)
    return sent


def test_no_window_holds_more_calls_than_are_allowed() -> None:
    async def go() -> list[float]:
        gate = SharedGate(rates={"simulated": Rate(calls_per_minute=4)}, window_s=0.2)
        return sorted(await asyncio.gather(*(once(gate) for _ in range(12))))

    sent = asyncio.run(go())
    assert all(later - sooner >= 0.2 for sooner, later in zip(sent, sent[4:], strict=False))
    assert sent[3] - sent[0] < 0.2


def test_no_window_exceeds_the_allowed_tokens_as_far_as_known() -> None:
    async def go() -> list[float]:
        gate = SharedGate(rates={"simulated": Rate(tokens_per_minute=450)}, window_s=0.2)
        await once(gate)  # what answers are like is not known before the first one
        return [await once(gate) for _ in range(6)]

    sent = asyncio.run(go())
    assert sent[2] - sent[0] >= 0.19 or sent[3] - sent[0] >= 0.19
    assert all(later - sooner >= 0.19 for sooner, later in zip(sent, sent[4:], strict=False))


def test_calls_under_way_are_limited_for_each_provider_by_itself() -> None:
    async def go() -> tuple[int, int]:
        gate = SharedGate(rates={"openai": Rate(max_concurrent=3)})
        now = {"openai:x": 0, "simulated:ideal": 0}
        most = dict(now)

        async def call(model: str) -> None:
            ticket = await gate.enter(model, CHARS, again=False)
            now[model] += 1
            most[model] = max(most[model], now[model])
            await asyncio.sleep(0.01)
            now[model] -= 1
            gate.leave(ticket, None, None)

        await asyncio.gather(*(call(model) for model in now for _ in range(10)))
        return most["openai:x"], most["simulated:ideal"]

    assert asyncio.run(go()) == (3, 10)


@pytest.mark.parametrize(
    ("budget", "calls"),
    [(Budget(max_calls=5), 5), (Budget(max_tokens=500), 5), (Budget(max_cost_usd=5.0), 5), (Budget(), 21)],
)
def test_many_at_once_do_not_overrun_a_budget(budget: Budget, calls: int) -> None:
    async def go() -> tuple[Spent, str | None]:
        gate = SharedGate(budget)
        await once(gate)  # no list has the price of this model
        await asyncio.gather(*(once(gate, hold_s=0.001) for _ in range(20)), return_exceptions=True)
        return gate.spent, gate.reason

    spent, reason = asyncio.run(go())
    assert spent == Spent(calls=calls, tokens=100 * calls, cost_usd=calls)
    assert (reason is None) == (budget == Budget())


def test_a_list_price_holds_calls_back_from_the_first_one_on() -> None:
    async def go() -> float:
        gate = SharedGate(Budget(max_cost_usd=0.02))

        async def call() -> None:
            ticket = await gate.enter("openai:gpt-4o", CHARS, again=False)
            await asyncio.sleep(0.001)
            gate.leave(ticket, Usage(input=100, output=500), 0.006)

        await asyncio.gather(*(call() for _ in range(50)), return_exceptions=True)
        return gate.spent.cost_usd

    assert 0.02 <= asyncio.run(go()) <= 0.02 + 0.006


def test_spending_of_other_processes_counts() -> None:
    gate = SharedGate(Budget(max_tokens=100))
    assert not gate.exhausted
    gate.elsewhere = Spent(tokens=100)
    assert gate.exhausted and gate.reason is not None and "of the sweep" in gate.reason


def test_a_call_that_is_made_again_is_no_new_one_for_the_budget() -> None:
    async def go() -> Spent:
        gate = SharedGate(Budget(max_calls=1))
        gate.leave(await gate.enter("simulated:ideal", CHARS, again=False), None, None)
        gate.leave(await gate.enter("simulated:ideal", CHARS, again=True), USED, 1.0)
        return gate.spent

    assert asyncio.run(go()) == Spent(calls=1, tokens=100, cost_usd=1.0)


class Quick:
    name = "simulated:ideal"

    async def ask(self, call: Call) -> Reply:
        return REPLY


def test_the_wait_for_a_turn_is_no_time_out_and_no_latency() -> None:
    async def go() -> list[Reply]:
        gate = SharedGate(rates={"simulated": Rate(calls_per_minute=1)}, window_s=0.2)
        limits = CallLimits(timeout_s=0.1, lane=CallLane(gate), rng=stream(0, Stream.BACKOFF))
        model = Limited(Quick(), limits)
        return list(await asyncio.gather(*(model.ask(CALL) for _ in range(3))))

    replies = asyncio.run(go())
    assert all(reply.faults == () and reply.latency_s < 0.1 for reply in replies)


def test_a_lane_knows_that_it_was_cut() -> None:
    async def go(shared: Budget, own: Budget) -> CallLane:
        lane = CallLane(SharedGate(shared))
        model = Limited(Quick(), CallLimits(lane=lane, meter=BudgetMeter(own), rng=stream(0, Stream.BACKOFF)))
        await model.ask(CALL)
        with pytest.raises(BudgetExceeded, match="is used up"):
            await model.ask(CALL)
        return lane

    assert asyncio.run(go(Budget(max_calls=1), Budget())).cut
    assert not asyncio.run(go(Budget(), Budget(max_calls=1))).cut
