"""Models and limits against a real server in its own process, over real sockets."""

from __future__ import annotations

import asyncio
import json
import logging
import math
import time
from collections import Counter
from typing import Any

import numpy as np
import pytest
from integration.fault_server import Server, completion, running
from slowness import slowness

from llm_flock.errors import BudgetExceeded, ModelError
from llm_flock.llm.client import CallSettings
from llm_flock.llm.limits import Budget, BudgetMeter, CallLimits, Limited, RetryPolicy
from llm_flock.llm.models import ModelPool
from llm_flock.llm.planner import LanguagePlanner
from llm_flock.llm.port import Attempt, Call, ChatMessage, Reply, Usage
from llm_flock.llm.prompting import PromptSet
from llm_flock.llm.providers import PROVIDERS
from llm_flock.mission import Mission
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion

KEY = "sk-very-secret-0123456789"
ANSWER = "Position: [1.0, 2.0]"


def call(robot: int = 0, round: int = 0) -> Call:
    messages = (ChatMessage("system", "You are a robot."), ChatMessage("user", "Where to?"))
    return Call(robot=robot, round=round, kind="step", attempt=0, messages=messages)


def pool_for(server: Server | str, timeout_s: float = 5.0) -> ModelPool:
    url = server if isinstance(server, str) else server.base_url
    return ModelPool(
        base_urls={"openai-compatible": url}, timeout_s=timeout_s, environ={"OPENAI_COMPATIBLE_API_KEY": KEY}
    )


async def ask_once(server: Server | str, timeout_s: float = 5.0) -> Reply | ModelError:
    async with pool_for(server, timeout_s) as pool:
        model = pool.model("openai-compatible:stand-in", robot=0, rng=np.random.default_rng(0))
        try:
            return await model.ask(call())
        except ModelError as error:
            return error


def test_an_answer_comes_with_its_usage_and_the_name_of_who_answered() -> None:
    with running(fixed_answer=ANSWER) as server:
        reply = asyncio.run(ask_once(server))
    assert isinstance(reply, Reply)
    assert reply.text == ANSWER
    assert reply.model == "openai-compatible:stand-in"
    assert reply.usage.input > 0 and reply.usage.output == 5
    assert reply.cost_usd is None  # nobody knows what a server at another address charges


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
            timeout_s=1.5,
            retry=RetryPolicy(max_tries=12, first_wait_s=0.01, longest_wait_s=0.1),
            meter=meter,
            rng=np.random.default_rng(5),
        )
        async with pool_for(server) as pool, asyncio.TaskGroup() as group:
            tasks = [
                group.create_task(
                    Limited(
                        pool.model("openai-compatible:stand-in", robot=i, rng=np.random.default_rng(i)), limits
                    ).ask(call(i))
                )
                for i in range(120)
            ]
        return [task.result() for task in tasks]

    with running(fixed_answer=ANSWER, latency=0.01, late_latency=3, retry_after=0.02, seed=3, **rates) as server:
        replies = asyncio.run(scenario(server))
        stats = server.stats()
    met = Counter(fault for reply in replies for fault in reply.faults)
    # A connection that the server cuts may take the next request on the same socket with it, never the reverse.
    assert met["rate_limit"] == stats["rate_limit"] > 0
    assert met["server"] == stats["server_error"] > 0
    assert met["garbage"] == stats["garbage"] - stats["unusable"] > 0
    assert met["timeout"] == stats["late"] > 0
    assert met["connection"] >= stats["cut"] > 0
    assert met == meter.faults
    assert meter.answered == meter.calls == 120
    assert stats["most_open"] <= 20 + 1  # and the one that asks for the counts


def test_two_hundred_calls_run_at_once() -> None:
    async def scenario(server: Server) -> float:
        limits = CallLimits(rng=np.random.default_rng(0))
        async with pool_for(server) as pool:
            models = [
                Limited(pool.model("openai-compatible:stand-in", robot=i, rng=np.random.default_rng(i)), limits)
                for i in range(200)
            ]
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
            timeout_s=1.0, retry=RetryPolicy(max_tries=20, first_wait_s=0.01), rng=np.random.default_rng(2)
        )

        async def think(robot: int, pool: ModelPool) -> tuple[PlanAnswer | NoAnswer, StepAnswer | NoAnswer]:
            model = pool.model("openai-compatible:stand-in", robot=robot, rng=np.random.default_rng(robot))
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

        async with pool_for(server) as pool:
            return await asyncio.gather(*(think(robot, pool) for robot in range(10)))

    rates = {"rate_limit": 0.1, "server_error": 0.1, "cut": 0.1, "garbage": 0.2, "late": 0.1}
    with running(latency=0.01, late_latency=2, retry_after=0.02, seed=1, **rates) as server:
        answers = asyncio.run(scenario(server))
        stats = server.stats()
    for robot, (plan, step) in enumerate(answers):
        assert isinstance(plan, PlanAnswer) and plan.slot == robot
        assert isinstance(step, StepAnswer)
        assert math.dist(step.waypoint, (10.0 * robot, 20.0)) <= mission.max_step + 1e-9
    met = Counter(fault for attempt in attempts for fault in attempt.faults)
    for kind, sent in (("rate_limit", "rate_limit"), ("server", "server_error"), ("timeout", "late")):
        assert met[kind] == stats[sent] > 0
    assert met["garbage"] == stats["garbage"] - stats["unusable"]
    assert sum(attempt.rejected is not None for attempt in attempts) == stats["unusable"] > 0


def test_max_calls_is_exact_under_concurrency() -> None:
    async def scenario(server: Server) -> int:
        limits = CallLimits(meter=BudgetMeter(Budget(max_calls=7)), rng=np.random.default_rng(0))
        async with pool_for(server) as pool:
            model = Limited(pool.model("openai-compatible:stand-in", robot=0, rng=np.random.default_rng(0)), limits)
            results = await asyncio.gather(*(model.ask(call(i)) for i in range(30)), return_exceptions=True)
        return sum(isinstance(result, BudgetExceeded) for result in results)

    with running(fixed_answer=ANSWER, latency=0.01) as server:
        refused = asyncio.run(scenario(server))
        assert server.stats()["requests"] == 7
    assert refused == 23


SCHEMA = {"type": "object", "properties": {"position": {"type": "array", "items": {"type": "number"}}}}


def talk(
    name: str, status: int, body: str, settings: CallSettings, kind: str = "application/json"
) -> tuple[Reply | ModelError, str, dict[str, Any]]:
    """Ask a model once for a structured answer, from a tiny server that gives this response.

    Returns:
        What came of it, and head and body of the request that the server saw.
    """
    got: list[str] = []

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = (await reader.readuntil(b"\r\n\r\n")).decode()
        length = next(int(h.split(":")[1]) for h in head.lower().split("\r\n") if h.startswith("content-length"))
        got.extend([head, (await reader.readexactly(length)).decode()])
        head = f"HTTP/1.1 {status} X\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\n\r\n"
        writer.write((head + body).encode())
        await writer.drain()
        writer.close()

    async def scenario() -> Reply | ModelError:
        server = await asyncio.start_server(handle, "127.0.0.1", 0)
        provider = name.partition(":")[0]
        urls = {provider: f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}/v1"}
        environ = {info.key_env: KEY for info in PROVIDERS.values()}
        async with server, ModelPool(base_urls=urls, timeout_s=5, environ=environ) as pool:
            model = pool.model(name, robot=0, rng=np.random.default_rng(0), settings=settings)
            messages = (ChatMessage("system", "You are a robot."), ChatMessage("user", "Where to?"))
            question = Call(robot=0, round=0, kind="step", attempt=0, messages=messages, schema=SCHEMA)
            try:
                return await model.ask(question)
            except ModelError as error:
                return error

    outcome = asyncio.run(scenario())
    head, sent = got
    return outcome, head, json.loads(sent)


def test_the_key_is_sent_and_nowhere_else_to_be_seen(caplog: pytest.LogCaptureFixture) -> None:
    """Careless gateways quote the key that they refuse."""
    body = json.dumps({"error": {"message": f"bad key {KEY}, starts with sk-very*****6789"}})
    with caplog.at_level(logging.DEBUG):
        error, head, _ = talk("openai-compatible:stand-in", 401, body, CallSettings())
    assert isinstance(error, ModelError)
    assert error.kind == "refused"
    assert KEY in head
    assert "[key]" in str(error) and KEY not in str(error) and "6789" not in str(error)
    assert error.__cause__ is None and error.__suppress_context__  # a traceback would print the provider's text
    assert KEY not in caplog.text


def test_settings_and_schema_are_sent() -> None:
    settings = CallSettings(temperature=0.5, seed=3, reasoning="low", max_tokens=99)
    reply, _, sent = talk("llamacpp:local", 200, completion(b"", '{"position": [1, 2]}').decode(), settings)
    assert isinstance(reply, Reply)
    assert reply.text == '{"position": [1, 2]}'
    wanted = {"model": "local", "temperature": 0.5, "seed": 3, "max_tokens": 99, "reasoning_effort": "low"}
    assert {name: sent.get(name) for name in wanted} == wanted
    assert [message["role"] for message in sent["messages"]] == ["system", "user"]
    assert "position" in sent["response_format"]["json_schema"]["schema"]["properties"]


def test_where_no_schema_is_supported_it_is_told_in_words() -> None:
    reply, _, sent = talk("deepseek:deepseek-chat", 200, completion(b"", "{}").decode(), CallSettings())
    assert isinstance(reply, Reply)
    assert sent["response_format"] == {"type": "json_object"}
    assert any("position" in message["content"] for message in sent["messages"] if message["role"] == "system")


def test_anthropic_is_asked_in_its_own_way() -> None:
    message = {
        "id": "msg_1",
        "type": "message",
        "role": "assistant",
        "model": "claude-sonnet-4-6",
        "content": [{"type": "text", "text": ANSWER}],
        "stop_reason": "end_turn",
        "stop_sequence": None,
        "usage": {"input_tokens": 30, "output_tokens": 8, "cache_read_input_tokens": 10},
    }
    reply, head, sent = talk(
        "anthropic:claude-sonnet-4-6", 200, json.dumps(message), CallSettings(temperature=0.5, max_tokens=1000)
    )
    assert isinstance(reply, Reply)
    assert (reply.text, reply.model) == (ANSWER, "anthropic:claude-sonnet-4-6")
    assert (reply.usage.output, reply.usage.cached) == (8, 10)
    assert reply.usage.input == 40  # Anthropic counts what came from its cache apart; here it is part of the input
    assert KEY in head and sent["temperature"] == 0.5


@pytest.mark.parametrize(("status", "kind"), [(529, "server"), (429, "rate_limit"), (400, "refused")])
def test_anthropic_faults_have_the_same_kinds(status: int, kind: str) -> None:
    body = json.dumps({"type": "error", "error": {"type": "some_error", "message": "no"}})
    error, _, _ = talk("anthropic:claude-sonnet-4-6", status, body, CallSettings())
    assert isinstance(error, ModelError)
    assert error.kind == kind


def test_anthropic_is_asked_to_cache_the_system_message() -> None:
    usage = {"input_tokens": 30, "output_tokens": 8, "cache_read_input_tokens": 90, "cache_creation_input_tokens": 5}
    message = {
        "id": "msg_1",
        "type": "message",
        "role": "assistant",
        "model": "claude-sonnet-4-6",
        "content": [
            {"type": "thinking", "thinking": "Position: [5, 0]", "signature": "x"},
            {"type": "text", "text": ANSWER},
        ],
        "stop_reason": "max_tokens",
        "stop_sequence": None,
        "usage": usage,
    }
    settings = CallSettings(max_tokens=1000)
    reply, _, sent = talk("anthropic:claude-sonnet-4-6", 200, json.dumps(message), settings)
    first, *others = sent["system"]
    assert first["text"] == "You are a robot." and first["cache_control"]["type"] == "ephemeral"
    assert not any("cache_control" in block for block in others)
    assert "cache_control" not in json.dumps(sent["messages"]) and "cache_control" not in sent
    assert sent["max_tokens"] == 1000
    assert isinstance(reply, Reply)
    assert reply.usage == Usage(input=125, output=8, cached=90)
    assert (reply.text, reply.finish_reason, reply.thought) == (ANSWER, "length", True)


def streamed(*events: dict[str, Any]) -> str:
    """Events of a stream in Anthropic's form."""
    return "".join(f"event: {event['type']}\ndata: {json.dumps(event)}\n\n" for event in events)


def test_a_stream_that_breaks_off_is_no_answer() -> None:
    """Without a cap on tokens, answers of Claude are streamed."""
    message = {"id": "m", "type": "message", "role": "assistant", "model": "claude-sonnet-4-6", "content": []}
    usage = {"input_tokens": 30, "output_tokens": 1}
    whole: list[dict[str, Any]] = [
        {"type": "message_start", "message": {**message, "stop_reason": None, "stop_sequence": None, "usage": usage}},
        {"type": "content_block_start", "index": 0, "content_block": {"type": "text", "text": ""}},
        {"type": "content_block_delta", "index": 0, "delta": {"type": "text_delta", "text": ANSWER}},
        {"type": "content_block_stop", "index": 0},
        {"type": "message_delta", "delta": {"stop_reason": "end_turn"}, "usage": {"output_tokens": 8}},
        {"type": "message_stop"},
    ]
    for count, reason in ((6, "stop"), (4, None), (3, None), (1, None)):
        body = streamed(*whole[:count])
        got, _, sent = talk("anthropic:claude-sonnet-4-6", 200, body, CallSettings(), "text/event-stream")
        assert sent["stream"] is True
        if reason is None:
            assert isinstance(got, ModelError) and got.kind == "server" and "broke" in got.detail
        else:
            assert isinstance(got, Reply) and (got.text, got.finish_reason) == (ANSWER, reason)


@pytest.mark.parametrize(
    ("text", "reason", "message", "expected"),
    [
        (ANSWER, "stop", {}, (ANSWER, "stop", False)),
        (ANSWER, "length", {}, (ANSWER, "length", False)),
        ("", "length", {"reasoning_content": f"Perhaps {ANSWER}"}, ("", "length", True)),
        ("", "stop", {"reasoning": f"Perhaps {ANSWER}"}, ("", "stop", True)),
        ("", "stop", {}, ("", "stop", False)),
        (f"<think>{ANSWER}</think>\nI stay.", "stop", {}, ("I stay.", "stop", True)),
        (f"<think>{ANSWER}", "stop", {}, (f"<think>{ANSWER}", "stop", True)),
        (f"hm {ANSWER}</think>I stay.", "stop", {}, ("I stay.", "stop", True)),
    ],
)
@pytest.mark.parametrize("name", ["vllm:qwen3", "ollama:qwen3:8b", "openai:gpt-4o", "deepseek:deepseek-reasoner"])
def test_cut_off_answers_and_thoughts_are_known_on_the_wire(
    name: str, text: str, reason: str, message: dict[str, str], expected: tuple[str, str, bool]
) -> None:
    """The SDK's own splitting would pass on a thought that does not end as if it were the answer."""
    reply, _, _ = talk(name, 200, completion(b"", text, reason, **message).decode(), CallSettings())
    assert isinstance(reply, Reply)
    assert (reply.text, reply.finish_reason, reply.thought) == expected


@pytest.mark.parametrize(
    ("name", "field"),
    [
        ("openai:gpt-4o", "max_completion_tokens"),
        ("deepseek:deepseek-chat", "max_tokens"),
        ("qwen:qwen-plus", "max_tokens"),
        ("ollama:qwen3:8b", "max_tokens"),
        ("vllm:qwen3", "max_tokens"),
        ("openai-compatible:any", "max_tokens"),
    ],
)
def test_the_cap_on_an_answer_goes_by_the_name_that_the_server_knows(name: str, field: str) -> None:
    _, _, sent = talk(name, 200, completion(b"", ANSWER).decode(), CallSettings(max_tokens=77))
    assert sent[field] == 77
    assert not {"max_tokens", "max_completion_tokens"} - {field} & set(sent)


@pytest.mark.parametrize(
    ("reason", "kind"), [("content_filter", "refused"), ("insufficient_system_resource", "server")]
)
def test_an_answer_that_the_provider_stops_is_a_failed_call(reason: str, kind: str) -> None:
    error, _, _ = talk("deepseek:deepseek-chat", 200, completion(b"", ANSWER, reason).decode(), CallSettings())
    assert isinstance(error, ModelError)
    assert error.kind == kind


def response(text: str | None, status: str = "completed", why: str | None = None) -> str:
    """A response in the form of OpenAI's Responses API; without a text it holds only a thought."""
    said = {"type": "output_text", "text": text, "annotations": []}
    message = {"type": "message", "id": "msg_1", "status": status, "role": "assistant", "content": [said]}
    return json.dumps(
        {
            "id": "resp_1",
            "object": "response",
            "created_at": 1,
            "status": status,
            "error": None,
            "incomplete_details": None if why is None else {"reason": why},
            "model": "gpt-5-mini-2025",
            "output": [{"type": "reasoning", "id": "rs_1", "summary": []}, *([] if text is None else [message])],
            "parallel_tool_calls": True,
            "tool_choice": "auto",
            "tools": [],
            "usage": {
                "input_tokens": 50,
                "input_tokens_details": {"cached_tokens": 20},
                "output_tokens": 30,
                "output_tokens_details": {"reasoning_tokens": 25},
                "total_tokens": 80,
            },
        }
    )


def test_the_responses_api_is_asked_in_its_own_way() -> None:
    settings = CallSettings(reasoning="low", max_tokens=900, seed=3)
    reply, head, sent = talk("openai-responses:gpt-5-mini", 200, response('{"position": [1, 2]}'), settings)
    assert isinstance(reply, Reply)
    assert head.startswith("POST /v1/responses ") and KEY in head
    assert (sent["model"], sent["reasoning"]["effort"], sent["max_output_tokens"]) == ("gpt-5-mini", "low", 900)
    assert sent["store"] is False and "seed" not in sent
    assert [item["role"] for item in sent["input"]] == ["system", "user"]
    assert "position" in sent["text"]["format"]["schema"]["properties"]
    assert (reply.text, reply.model) == ('{"position": [1, 2]}', "openai-responses:gpt-5-mini-2025")
    assert reply.usage == Usage(input=50, output=30, cached=20)
    assert (reply.finish_reason, reply.thought) == ("stop", True)
    assert reply.settings == {"reasoning": "low", "max_tokens": 900, "seed": 3}


@pytest.mark.parametrize("text", ["Position: [1.0, 2.0]", None])
def test_an_incomplete_response_is_cut_off(text: str | None) -> None:
    body = response(text, "incomplete", "max_output_tokens")
    reply, _, _ = talk("openai-responses:gpt-5-mini", 200, body, CallSettings(max_tokens=30))
    assert isinstance(reply, Reply)
    assert (reply.text, reply.finish_reason, reply.thought) == (text or "", "length", True)


@pytest.mark.parametrize(
    ("status", "why", "kind"), [("incomplete", "content_filter", "refused"), ("failed", None, "server")]
)
def test_a_response_that_is_stopped_is_a_failed_call(status: str, why: str | None, kind: str) -> None:
    error, _, _ = talk("openai-responses:gpt-5-mini", 200, response(ANSWER, status, why), CallSettings())
    assert isinstance(error, ModelError)
    assert error.kind == kind
