"""What is sent to each provider's API, and how its answers are read, over real sockets."""

from __future__ import annotations

import asyncio
import json
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from integration.fault_server import completion

from llm_flock.errors import ModelError
from llm_flock.llm._client import CallSettings
from llm_flock.llm._models import ModelPool
from llm_flock.llm._port import Call, ChatMessage, Reply, Usage
from llm_flock.llm._providers import PROVIDERS

KEY = "sk-very-secret-0123456789"
ANSWER = "Position: [1.0, 2.0]"
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
        sent = body.encode()
        head = f"HTTP/1.1 {status} X\r\nContent-Type: {kind}\r\nContent-Length: {len(sent)}\r\n\r\n"
        writer.write(head.encode() + sent)
        await writer.drain()
        writer.close()

    async def scenario() -> Reply | ModelError:
        server = await asyncio.start_server(handle, "127.0.0.1", 0)
        provider = name.partition(":")[0]
        urls = {provider: f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}/v1"}
        environ = {info.key_env: KEY for info in PROVIDERS.values()}
        async with server, ModelPool(environ=environ) as pool:
            model = pool.model(name, rng=np.random.default_rng(0), settings=settings, base_urls=urls, timeout_s=5)
            messages = (ChatMessage("system", "You are a robot."), ChatMessage("user", "Where to?"))
            question = Call(robot=0, round=0, kind="step", attempt=0, messages=messages, schema=SCHEMA)
            try:
                return await model.ask(question)
            except ModelError as error:
                return error

    outcome = asyncio.run(scenario())
    head, sent = got[-2:]
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


def test_prompt_describes_the_schema_if_unsupported() -> None:
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
def test_answer_cap_goes_by_the_name_the_server_knows(name: str, field: str) -> None:
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


BODIES: list[dict[str, Any]] = json.loads((Path(__file__).parents[1] / "cases/bodies.json").read_text(encoding="utf-8"))
"""Bodies with status 200 and what is meant: `read`, `length` (cut off), `empty`, or the kind of an error."""


@pytest.mark.parametrize("case", BODIES, ids=lambda case: case["kind"])
def test_a_body_is_read_or_is_the_error_it_says(case: dict[str, Any]) -> None:
    got, _, _ = talk("openai-compatible:stand-in", 200, case["body"], CallSettings(), case["content_type"])
    if case["means"] in ("read", "length", "empty"):
        assert isinstance(got, Reply), got
        assert got.text == ("" if case["means"] == "empty" else "Position: [45.5, 51.0]")
        assert (got.finish_reason == "length") == (case["means"] == "length")
    else:
        assert isinstance(got, ModelError), got
        assert got.kind == case["means"] and case["says"].lower() in str(got).lower()
