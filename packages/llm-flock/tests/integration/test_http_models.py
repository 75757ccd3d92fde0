"""Models and limits against a real server in its own process, over real sockets."""

from __future__ import annotations

import asyncio
import gzip
import json
import math
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from integration.fault_server import REFUSALS, Server, answering, completion, running
from slowness import slowness
from typer.testing import CliRunner

import llm_flock
from llm_flock.cli import app
from llm_flock.errors import BudgetExceeded, ModelError
from llm_flock.llm._dialect import Dialect
from llm_flock.llm._limits import Budget, BudgetMeter, CallLimits, Limited, RetryPolicy
from llm_flock.llm._models import ModelPool
from llm_flock.llm._planner import LanguagePlanner
from llm_flock.llm._port import Attempt, Call, ChatMessage, LanguageModel, Reply
from llm_flock.llm._prompting import PromptSet
from llm_flock.mission import Mission
from llm_flock.planner import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.record import caveats

KEY = "sk-very-secret-0123456789"
ANSWER = "Position: [1.0, 2.0]"


def call(robot: int = 0, round: int = 0) -> Call:
    messages = (ChatMessage("system", "You are a robot."), ChatMessage("user", "Where to?"))
    return Call(robot=robot, round=round, kind="step", attempt=0, messages=messages)


def model_of(pool: ModelPool, server: Server | str, robot: int = 0, timeout_s: float = 5.0) -> LanguageModel:
    urls = {"openai-compatible": server if isinstance(server, str) else server.base_url}
    rng = np.random.default_rng(robot)
    return pool.model("openai-compatible:stand-in", rng=rng, base_urls=urls, timeout_s=timeout_s)


def new_pool() -> ModelPool:
    return ModelPool(environ={"OPENAI_COMPATIBLE_API_KEY": KEY})


async def ask_once(server: Server | str, timeout_s: float = 5.0) -> Reply | ModelError:
    async with new_pool() as pool:
        try:
            return await model_of(pool, server, timeout_s=timeout_s).ask(call())
        except ModelError as error:
            return error


def test_answer_has_usage_and_name_of_the_model() -> None:
    with running(fixed_answer=ANSWER) as server:
        reply = asyncio.run(ask_once(server))
    assert isinstance(reply, Reply)
    assert reply.text == ANSWER
    assert reply.model == "openai-compatible:stand-in"
    assert reply.usage.input > 0 and reply.usage.output == 5
    assert reply.cost_usd is None  # the price of a server at another address is unknown


@pytest.mark.parametrize(
    ("options", "kind"),
    [
        ({"rate_limit": 1, "retry_after": 0.25}, "rate_limit"),
        ({"server_error": 1}, "server"),
        ({"late": 1, "late_latency": 3}, "timeout"),
    ],
)
def test_each_fault_has_its_kind(options: dict[str, float], kind: str) -> None:
    with running(fixed_answer=ANSWER, **options) as server:
        error = asyncio.run(ask_once(server, timeout_s=0.3))
        stats = server.stats()
    assert isinstance(error, ModelError)
    assert error.kind == kind
    assert error.retry_after_s == (0.25 if kind == "rate_limit" else None)
    assert stats["requests"] == 1  # nothing below us retries behind our back


def test_cut_connections_and_garbage_have_their_kinds() -> None:
    async def many(server: Server) -> list[Reply | ModelError]:
        return [await ask_once(server) for _ in range(4)]

    with running(fixed_answer=ANSWER, cut=1) as server:
        cuts = asyncio.run(many(server))
    assert [error.kind for error in cuts if isinstance(error, ModelError)] == ["connection"] * 4
    with running(fixed_answer=ANSWER, garbage=1) as server:
        *garbage, unusable = asyncio.run(many(server))
    assert [error.kind for error in garbage if isinstance(error, ModelError)] == ["garbage"] * 3
    assert isinstance(unusable, Reply)  # a proper response: whether its text is of use is the planner's question


@pytest.mark.parametrize("what", REFUSALS)
def test_a_server_that_refuses_a_form_is_asked_in_another(what: str, caplog: pytest.LogCaptureFixture) -> None:
    """A whole team flies: one question is sent twice, and the record says what was left out."""
    with running(refuses=what) as server:
        result = llm_flock.run(
            Mission(shape="triangle", n_robots=3),
            model="openai-compatible:stand-in",
            base_url=server.base_url,
            answers="json",
            temperature=0.0,
            model_seed=1,
            reasoning_effort="low",
            max_answer_tokens=500,
            start="connected",
        )
        stats = server.stats()
    assert result.formed and stats["refused"] == 1 and result.summary.calls_failed == 0
    assert stats["requests"] == result.summary.model_calls + 1
    left_out = {"turns": "roles", "system": "roles", "reasoning_effort": "reasoning"}.get(what, what)
    assert [f"refuses {left_out}, and is asked without" in text for text in caplog.messages].count(True) == 1


def test_what_an_address_refuses_is_known_from_then_on() -> None:
    async def both(server: Server) -> list[Reply | ModelError]:
        return [await ask_once(server), await ask_once(server)]

    with running(fixed_answer=ANSWER, refuses="system") as server:
        replies = asyncio.run(both(server))
        stats = server.stats()
    assert [reply.settings for reply in replies if isinstance(reply, Reply)] == [{"without": ["roles"]}] * 2
    assert stats["refused"] == 1


@pytest.mark.parametrize(
    ("message", "param", "left_out"),
    [
        ("Only user and assistant roles are supported!", None, ["roles"]),
        ("Developer instruction is not enabled for models/gemma-3-27b-it", None, ["roles"]),
        ("Invalid value: 'system'. Supported values are: 'assistant' and 'user'.", None, ["roles"]),
        ("Unsupported value", "temperature", ["temperature"]),
        ("JSON mode is not enabled for models/gemma-3-27b-it", None, ["response_format"]),
        ("错", None, ["temperature", "roles", "response_format"]),
        ("This answer would break our policy", None, []),
    ],
)
def test_refusals_in_many_words_are_understood(message: str, param: str | None, left_out: list[str]) -> None:
    """In words that mean nothing to the client, all that a server could lack is left out at once."""
    dialect, sent = Dialect(message, "m"), {"temperature": 0.0, "roles": True, "response_format": True}
    asked_again = dialect.refuses(f"{message} {param or ''}", sent, unclear=True)
    assert asked_again == bool(left_out) and dialect.without == left_out


def test_a_plain_request_that_is_refused_too_teaches_nothing() -> None:
    body = json.dumps({"error": {"message": "Bad request"}}).encode()
    with answering(body, status=400) as (url, requests):
        error = asyncio.run(ask_once(url))
        again = asyncio.run(ask_once(url))
    assert isinstance(error, ModelError) and isinstance(again, ModelError) and len(requests) == 4


def test_a_server_that_has_moved_is_not_asked_again() -> None:
    with answering(b"", status=301, location="http://127.0.0.1:9/v1") as (url, _):
        error = asyncio.run(ask_once(url))
    assert isinstance(error, ModelError) and error.kind == "refused" and "new address into --base-url" in error.detail


def test_a_request_that_is_too_large_is_asked_no_other_way() -> None:
    body = json.dumps({"error": {"message": "max_tokens exceeds the context size of 2048"}}).encode()
    with answering(body, status=400) as (url, requests):
        error = asyncio.run(ask_once(url))
    assert isinstance(error, ModelError) and error.kind == "refused" and len(requests) == 1


@pytest.mark.parametrize(
    ("headers", "body", "wait"),
    [
        ({"Retry_After": "1.5"}, {}, 1.5),
        ({"retry_after_ms": "2500"}, {}, 2.5),
        ({"Retry_After": "900"}, {}, 900.0),
        ({}, {"error": {"details": [{"@type": "RetryInfo", "retryDelay": "34.5s"}]}}, 34.5),
        ({}, {"error": {"message": "retry in 3s"}}, None),
    ],
)
def test_every_form_of_a_wait_is_read(headers: dict[str, str], body: dict[str, Any], wait: float | None) -> None:
    with answering(json.dumps(body).encode(), 1, 429, **headers) as (url, _):
        error = asyncio.run(ask_once(url))
    assert isinstance(error, ModelError) and (error.kind, error.retry_after_s) == ("rate_limit", wait)


@pytest.mark.parametrize(
    ("status", "message", "advice"),
    [
        (400, "the request exceeds the available context size (4096 tokens)", "give it a larger one"),
        (404, "model 'qwen' not found, try pulling it first", "check --model"),
        (404, "Not Found", "check --base-url"),
        (401, "no key", None),
    ],
)
def test_a_refusal_says_what_to_change(status: int, message: str, advice: str | None) -> None:
    with answering(json.dumps({"error": {"message": message}}).encode(), 1, status) as (url, _):
        error = asyncio.run(ask_once(url))
    assert isinstance(error, ModelError) and error.kind == "refused" and message in error.detail
    assert (advice is None) == error.detail.startswith("status_code") and (advice or "") in error.detail


def test_tokens_that_a_server_does_not_report_are_estimated() -> None:
    whole = json.loads(completion(b"", ANSWER))
    del whole["usage"]
    with answering(json.dumps(whole).encode()) as (url, _):
        reply = asyncio.run(ask_once(url))
    assert isinstance(reply, Reply) and reply.settings == {"usage": "estimated"}
    assert (reply.usage.input, reply.usage.output) == (7, 5)


def test_a_body_without_end_is_not_read_to_its_end() -> None:
    """1.2 GB in one response: memory for a few megabytes of it is all that is spent."""
    with answering(b" " * (1 << 20), repeat=1200) as (url, requests):
        error = asyncio.run(ask_once(url))
    assert isinstance(error, ModelError) and error.kind == "garbage" and "larger than 2 MiB" in error.detail
    assert requests[-1]["sent"] < 64


def test_a_few_bytes_that_unpack_to_many_are_refused() -> None:
    packed = gzip.compress(b" " * (100 << 20))
    with answering(packed, Content_Encoding="gzip") as (url, _):
        error = asyncio.run(ask_once(url))
    assert isinstance(error, ModelError) and error.kind == "garbage" and "compressed" in error.detail


def test_a_server_that_is_not_there_is_a_connection_fault() -> None:
    with running(fixed_answer=ANSWER) as server:
        gone = server.base_url
    error = asyncio.run(ask_once(gone))
    assert isinstance(error, ModelError)
    assert error.kind == "connection"


def test_a_wrong_path_is_refused() -> None:
    with running(fixed_answer=ANSWER) as server:
        error = asyncio.run(ask_once(server.base_url + "/nowhere"))
    assert isinstance(error, ModelError)
    assert error.kind == "refused"


def test_limits_get_every_answer_through_and_count_every_fault() -> None:
    rates = {"rate_limit": 0.1, "server_error": 0.1, "cut": 0.1, "garbage": 0.1, "late": 0.05}
    meter = BudgetMeter()

    async def scenario(server: Server) -> list[Reply]:
        limits = CallLimits(
            max_concurrent=20,
            timeout_s=3.0,
            retry=RetryPolicy(max_tries=12, max_garbage=12, first_wait_s=0.01, longest_wait_s=0.1),
            meter=meter,
            rng=np.random.default_rng(5),
        )
        async with new_pool() as pool, asyncio.TaskGroup() as group:
            tasks = [group.create_task(Limited(model_of(pool, server, i), limits).ask(call(i))) for i in range(120)]
        return [task.result() for task in tasks]

    with running(fixed_answer=ANSWER, latency=0.01, late_latency=6, retry_after=0.02, seed=3, **rates) as server:
        replies = asyncio.run(scenario(server))
        stats = server.stats()
    met = Counter(fault for reply in replies for fault in reply.faults)
    # Calls that a busy machine delayed time out, too; what the server says to one of them is not met any more.
    missed = met["timeout"] - stats["late"]
    assert missed >= 0 < stats["late"]
    assert 0 <= stats["rate_limit"] - met["rate_limit"] <= missed and met["rate_limit"]
    assert 0 <= stats["server_error"] - met["server"] <= missed and met["server"]
    assert 0 <= stats["garbage"] - stats["unusable"] - met["garbage"] <= missed and met["garbage"]
    # A connection that the server cuts may take the next request on the same socket with it, never the reverse.
    assert met["connection"] >= stats["cut"] - missed and met["connection"]
    assert len(replies) == meter.spent.calls == 120
    assert stats["most_open"] <= 20 + 1  # and the one that asks for the counts


def test_two_hundred_calls_run_at_once() -> None:
    async def scenario(server: Server) -> float:
        limits = CallLimits(rng=np.random.default_rng(0))
        async with new_pool() as pool:
            models = [Limited(model_of(pool, server, i), limits) for i in range(200)]
            await models[0].ask(call(0))  # the first call pays for imports
            started = time.perf_counter()
            async with asyncio.TaskGroup() as group:
                for i, model in enumerate(models):
                    group.create_task(model.ask(call(i)))
            return time.perf_counter() - started

    with running(fixed_answer=ANSWER, latency=1) as server:
        took_s = asyncio.run(scenario(server))
        stats = server.stats()
    assert stats["most_open"] >= 200
    assert (
        took_s < 3.0 * slowness()
    )  # one after another it would be 200 s, through a pool of 100 connections 2 s and the work


def test_the_stand_in_plans_and_steps_over_http() -> None:
    """Prompt, wire, answer and parser together, through every fault at once."""
    mission = Mission(n_robots=10)
    attempts: list[Attempt] = []

    async def scenario(server: Server) -> list[tuple[PlanAnswer | NoAnswer, StepAnswer | NoAnswer]]:
        limits = CallLimits(
            timeout_s=1.0,
            retry=RetryPolicy(max_tries=20, max_garbage=20, first_wait_s=0.01),
            rng=np.random.default_rng(2),
        )

        async def think(robot: int, pool: ModelPool) -> tuple[PlanAnswer | NoAnswer, StepAnswer | NoAnswer]:
            model = model_of(pool, server, robot)
            planner = LanguagePlanner(
                robot,
                Limited(model, limits),
                PromptSet.load(),
                max_retries=8,
                on_attempt=attempts.append,
            )
            here = (10.0 * robot, 20.0)
            plan = await planner.plan(PlanQuestion(mission=mission, robot=robot, round=0, position=here, neighbors=()))
            assert isinstance(plan, PlanAnswer)
            step = await planner.step(
                StepQuestion(
                    mission=mission, robot=robot, round=1, position=here, neighbors=(), plan=plan.plan, slot=plan.slot
                )
            )
            return plan, step

        async with new_pool() as pool:
            return await asyncio.gather(*(think(robot, pool) for robot in range(10)))

    rates = {"rate_limit": 0.1, "server_error": 0.1, "cut": 0.1, "garbage": 0.2, "late": 0.1}
    with running(latency=0.01, late_latency=2, retry_after=0.02, seed=1, **rates) as server:
        answers = asyncio.run(scenario(server))
        stats = server.stats()
    for robot, (plan, step) in enumerate(answers):
        assert isinstance(plan, PlanAnswer) and plan.slot == robot
        assert isinstance(step, StepAnswer)
        assert math.dist(step.waypoint, (10.0 * robot, 20.0)) <= mission.max_step + 1e-9
    met = Counter(fault for attempt in attempts for fault in attempt.reply.faults)
    for kind, sent in (("rate_limit", "rate_limit"), ("server", "server_error"), ("timeout", "late")):
        assert met[kind] == stats[sent] > 0
    assert met["garbage"] == stats["garbage"] - stats["unusable"]
    assert sum(attempt.rejected is not None for attempt in attempts) == stats["unusable"] > 0


def test_max_calls_is_exact_under_concurrency() -> None:
    async def scenario(server: Server) -> int:
        limits = CallLimits(meter=BudgetMeter(Budget(max_calls=7)), rng=np.random.default_rng(0))
        async with new_pool() as pool:
            model = Limited(model_of(pool, server), limits)
            results = await asyncio.gather(*(model.ask(call(i)) for i in range(30)), return_exceptions=True)
        return sum(isinstance(result, BudgetExceeded) for result in results)

    with running(fixed_answer=ANSWER, latency=0.01) as server:
        refused = asyncio.run(scenario(server))
        assert server.stats()["requests"] == 7
    assert refused == 23


@pytest.mark.parametrize(("asked", "warned"), [("small", False), ("gpt-9", True)])
def test_a_run_names_the_model_that_answered(asked: str, warned: bool, tmp_path: Path) -> None:
    body = json.loads(completion(b"", ANSWER)) | {"model": "/models/Small-[7B].gguf"}
    with answering(json.dumps(body).encode()) as (url, _):
        result = llm_flock.run(
            llm_flock.Mission(shape="triangle", n_robots=3),
            model=f"openai-compatible:{asked}",
            base_url=url,
            rounds=1,
            max_retries=0,
            fallback="hold",
            out=str(tmp_path),
        )
    name, told = "openai-compatible:/models/Small-[7B].gguf", result.summary.to_dict()
    caveat = f"the model that answered is {name}, not openai-compatible:{asked}"
    assert told["answered_by"] == (name,)
    assert (caveat in caveats(told, result.mission.model_dump())) is warned
    shown = " ".join(CliRunner().invoke(app, ["inspect", str(tmp_path)]).stdout.split())
    assert (caveat[1:] in shown) is warned and f"seed 0 · {name} · complete" in shown
