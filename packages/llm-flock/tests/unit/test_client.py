"""One call through pydantic-ai: messages, usage, price, errors, secrets."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import httpx2
import pytest
from pydantic_ai import exceptions as pai
from pydantic_ai.messages import ModelMessage, ModelRequest, ModelResponse, TextPart, ThinkingPart
from pydantic_ai.models.function import AgentInfo, FunctionModel
from pydantic_ai.usage import RequestUsage

from llm_flock.errors import ModelError
from llm_flock.llm import _client as client
from llm_flock.llm._client import DETAIL_LENGTH, CallSettings, PydanticModel, error_kind, scrub, to_model_messages
from llm_flock.llm._port import MAX_TOKENS, Call, ChatMessage, Reply, Usage

KEY = "0123456789-abcdefghij"
LEFT_OUT = "[a text with a key in it]"


def call(*messages: ChatMessage, schema: dict[str, Any] | None = None) -> Call:
    return Call(robot=0, round=0, kind="step", attempt=0, messages=messages or (user("Where to?"),), schema=schema)


def user(text: str) -> ChatMessage:
    return ChatMessage("user", text)


def model(function: Callable[..., Any], name: str = "openai:o3-mini", **options: Any) -> PydanticModel:
    async def answer(messages: list[ModelMessage], info: AgentInfo) -> ModelResponse:
        return function(messages, info)

    stand_in = FunctionModel(answer, model_name=name.partition(":")[2])
    return PydanticModel(stand_in, name=name, secrets=(KEY,), **options)


def ask(model: PydanticModel, question: Call | None = None) -> Reply:
    return asyncio.run(model.ask(question or call()))


def failing(error: Exception) -> ModelError:
    def fail(*_: Any) -> ModelResponse:
        raise error

    with pytest.raises(ModelError) as caught:
        ask(model(fail))
    return caught.value


def test_a_conversation_becomes_requests_and_responses() -> None:
    said = (
        ChatMessage("system", "S"),
        user("Q1"),
        ChatMessage("assistant", "A1"),
        user("Q2"),
    )
    out = to_model_messages(said)
    assert [type(message) for message in out] == [ModelRequest, ModelResponse, ModelRequest]
    parts = [(part.part_kind, getattr(part, "content", None)) for message in out for part in message.parts]
    assert parts == [("system-prompt", "S"), ("user-prompt", "Q1"), ("text", "A1"), ("user-prompt", "Q2")]


def test_a_reply_has_text_usage_price_and_what_was_asked_for() -> None:
    def answer(messages: list[ModelMessage], info: AgentInfo) -> ModelResponse:
        assert info.model_settings == {"temperature": 0.5, "seed": 3, "openai_reasoning_effort": "low"}
        usage = RequestUsage(input_tokens=1000, output_tokens=100, cache_read_tokens=400)
        return ModelResponse(parts=[ThinkingPart("hm"), TextPart("Position: [1, 2]")], usage=usage)

    settings = CallSettings(temperature=0.5, seed=3, reasoning="low")
    reply = ask(model(answer, settings=settings, priced=True))
    assert reply.text == "Position: [1, 2]"
    assert reply.model == "openai:o3-mini"
    assert reply.usage == Usage(input=1000, output=100, cached=400)
    assert reply.settings == {"temperature": 0.5, "seed": 3, "reasoning": "low"}
    assert reply.cost_usd == pytest.approx((600 * 1.10 + 400 * 0.55 + 100 * 4.40) / 1e6)


def test_a_provider_may_say_any_number_of_tokens() -> None:
    """More than a record holds ended the run of all robots."""

    def answer(messages: list[ModelMessage], info: AgentInfo) -> ModelResponse:
        usage = RequestUsage(input_tokens=2**53 + 1, output_tokens=-(2**70), cache_read_tokens=2**60)
        return ModelResponse(parts=[TextPart("Position: [1, 2]")], usage=usage)

    assert ask(model(answer)).usage == Usage(input=MAX_TOKENS, output=0, cached=MAX_TOKENS)


def test_anthropic_takes_the_unified_reasoning_setting() -> None:
    def answer(messages: list[ModelMessage], info: AgentInfo) -> ModelResponse:
        assert "openai_reasoning_effort" not in (info.model_settings or {})
        return ModelResponse(parts=[TextPart("x")])

    ask(model(answer, name="anthropic:claude", settings=CallSettings(reasoning="none")))


def test_latency_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [10.0]

    def slow(*_: Any) -> ModelResponse:
        now[0] += 2.5
        return ModelResponse(parts=[TextPart("x")])

    monkeypatch.setattr(client, "time", SimpleNamespace(perf_counter=lambda: now[0]))
    assert ask(model(slow)).latency_s == 2.5


@pytest.mark.parametrize("text", ["", "  \n "])
def test_an_empty_answer_is_an_answer(text: str) -> None:
    assert ask(model(lambda *_: ModelResponse(parts=[TextPart(text)]))).text == text


@pytest.mark.parametrize(
    "response",
    [
        ModelResponse(parts=[ThinkingPart("hm")]),
        ModelResponse(parts=[ThinkingPart("", id="redacted_thinking", signature="x")]),
        ModelResponse(parts=[], usage=RequestUsage(output_tokens=9, details={"reasoning_tokens": 9})),
        ModelResponse(parts=[TextPart("<think>Position: [5, 0]</think>\n")]),
    ],
    ids=["a part of its own", "hidden", "only counted", "in the text"],
)
def test_answer_of_thoughts_only_is_empty_and_marked(response: ModelResponse) -> None:
    reply = ask(model(lambda *_: response))
    assert reply.text == "" and reply.thought
    assert not ask(model(lambda *_: ModelResponse(parts=[TextPart("")]))).thought


def test_thoughts_leave_the_text_unless_they_never_end() -> None:
    reply = ask(model(lambda *_: ModelResponse(parts=[TextPart("<think>[5, 0]</think>\n\nPosition: [1, 2]")])))
    assert (reply.text, reply.thought) == ("Position: [1, 2]", True)
    reply = ask(model(lambda *_: ModelResponse(parts=[TextPart("<think>Position: [5, 0]")])))
    assert (reply.text, reply.thought) == ("<think>Position: [5, 0]", True)


@pytest.mark.parametrize(
    ("given", "raw", "reason"),
    [
        ("stop", "stop", "stop"),
        ("length", "length", "length"),
        ("length", None, "length"),
        (None, "max_tokens", "length"),
        (None, "MODEL_LENGTH", "length"),
        (None, "eos_token", "eos_token"),
        (None, "what? " * 20, None),
        (None, None, None),
    ],
)
def test_a_reply_says_why_it_ends(given: Any, raw: str | None, reason: str | None) -> None:
    details = {} if raw is None else {"finish_reason": raw}
    response = ModelResponse(parts=[TextPart("x")], finish_reason=given, provider_details=details)
    assert ask(model(lambda *_: response)).finish_reason == reason


@pytest.mark.parametrize(
    ("response", "kind", "says"),
    [
        (ModelResponse(parts=[], finish_reason="content_filter"), "refused", "content filter"),
        (
            ModelResponse(parts=[], finish_reason="content_filter", provider_details={"refusal": f"no, {KEY}"}),
            "refused",
            r"no, \[key\]",
        ),
        (ModelResponse(parts=[TextPart("x")], finish_reason="error"), "server", "error"),
        (
            ModelResponse(parts=[TextPart("x")], provider_details={"finish_reason": "insufficient_system_resource"}),
            "server",
            "insufficient_system_resource",
        ),
        (ModelResponse(parts=[TextPart("Position: [1, 2]")], state="incomplete"), "server", "broke the answer off"),
    ],
)
def test_an_answer_that_was_stopped_is_a_failed_call(response: ModelResponse, kind: str, says: str) -> None:
    with pytest.raises(ModelError, match=says) as caught:
        ask(model(lambda *_: response))
    assert caught.value.kind == kind


def test_a_schema_asks_for_structured_output() -> None:
    schema = {"type": "object", "properties": {"position": {"type": "array"}}}

    def answer(messages: list[ModelMessage], info: AgentInfo) -> ModelResponse:
        assert info.model_request_parameters.output_mode == "native"
        assert info.model_request_parameters.output_object is not None
        assert "position" in info.model_request_parameters.output_object.json_schema["properties"]
        return ModelResponse(parts=[TextPart('{"position": [1, 2]}')])

    assert ask(model(answer), call(user("?"), schema=schema)).text == '{"position": [1, 2]}'


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (pai.ModelTimeoutError("m", "slow"), "timeout"),
        (pai.ModelRequestTimeout("m", 1.0), "timeout"),
        (TimeoutError(), "timeout"),
        (httpx2.ReadTimeout("slow"), "timeout"),
        (pai.ModelHTTPError(408, "m"), "timeout"),
        (pai.ModelRateLimitError("m", "slow down"), "rate_limit"),
        (pai.ModelHTTPError(429, "m"), "rate_limit"),
        (pai.ModelServerError("m", "oops"), "server"),
        (pai.ModelOverloadedError("m", "full"), "server"),
        (pai.ModelHTTPError(503, "m"), "server"),
        (pai.ModelConnectionError("m", "gone"), "connection"),
        (httpx2.RemoteProtocolError("cut"), "connection"),
        (ConnectionResetError("reset"), "connection"),
        (pai.ModelAuthenticationError("m", "no"), "refused"),
        (pai.ModelQuotaExceededError("m", "no money"), "refused"),
        (pai.ContentFilterError("no"), "refused"),
        (pai.ModelHTTPError(400, "m"), "refused"),
        (pai.UserError("cannot"), "refused"),
        (pai.UnexpectedModelBehavior("what?"), "garbage"),
        (pai.ModelAPIError("m", "not JSON"), "garbage"),
    ],
    ids=lambda value: value if isinstance(value, str) else type(value).__name__,
)
def test_every_exception_has_its_kind(error: Exception, kind: str) -> None:
    assert error_kind(error) == kind
    assert failing(error).kind == kind


@pytest.mark.parametrize("error", [ValueError("x"), KeyError("x"), TypeError("x"), AssertionError("x")])
def test_a_response_that_breaks_the_parser_is_garbage(error: Exception) -> None:
    assert failing(error).kind == "garbage"


@pytest.mark.parametrize(
    ("headers", "seconds"),
    [
        ({"Retry-After": "7"}, 7.0),
        ({"retry-after-ms": "250", "Retry-After": "1"}, 0.25),
        ({"Retry-After": "Wed, 21 Oct 2015 07:28:00 GMT"}, 0.0),
        ({"Retry-After": "soon"}, None),
        ({}, None),
    ],
)
def test_retry_after_is_passed_on(headers: dict[str, str], seconds: float | None) -> None:
    assert failing(pai.ModelHTTPError(429, "m", headers=headers)).retry_after_s == seconds


def test_no_key_leaves_by_an_error_or_an_answer() -> None:
    error = failing(pai.ModelHTTPError(401, "m", body={"message": f"bad {KEY} and sk-abc*****6789"}))
    assert KEY not in str(error) and "6789" not in str(error)
    # A key that the length limit would cut in half must go, too.
    error = failing(ValueError("x" * (DETAIL_LENGTH - 60) + KEY + "y" * 100))
    assert KEY[:6] not in str(error) and len(error.detail) <= DETAIL_LENGTH
    assert error.__cause__ is None and error.__suppress_context__
    assert ask(model(lambda *_: ModelResponse(parts=[TextPart(f"my key is {KEY}")]))).text == "my key is [key]"


@pytest.mark.parametrize(
    "between", [" ", "\n", "-", "\u200b", "\u3164", ", ", "\\n", "\\u3164", "%20", "&nbsp;", "<wbr>", '" "']
)
def test_no_key_leaves_with_anything_between_its_letters(between: str) -> None:
    assert scrub(f"at n{between.join(KEY)}; and", (KEY, "another-key-of-somebody")) == LEFT_OUT
    assert LEFT_OUT in str(failing(ValueError(f"bad {between.join(KEY)}")))


def test_a_key_may_begin_like_an_escape() -> None:
    assert scrub(r"\n o p q r s t u v w x y z", ("nopqrstuvwxyz",)) == LEFT_OUT


@pytest.mark.parametrize(
    "form", ["%{:02x}", "%{:02X}", "\\u{:04x}", "\\x{:02x}", "&#{};", "&#x{:x};", f"&#{'0' * 5000}{{}};"]
)
def test_no_key_leaves_with_escaped_letters(form: str) -> None:
    escaped = [form.format(ord(letter)) if k % 3 else letter for k, letter in enumerate(KEY)]
    for between in ("", " "):
        assert scrub(f"with {between.join(escaped)} in it", (KEY,)) == LEFT_OUT


@pytest.mark.parametrize("number", ["9" * 5000, "0" * 5000 + "9" * 5000, "x" + "f" * 5000])
def test_no_number_of_a_letter_is_too_long(number: str) -> None:
    assert scrub(f"&#{number}; {KEY}", (KEY,)) == f"&#{number}; [key]"


def test_scrubbing_leaves_other_text_alone() -> None:
    text = "risk-averse task-oriented sk-8 Position: [1, 2] %41 &amp; \\n no negative"
    assert scrub(text, ("", KEY, "none")) == text


def test_lone_surrogate_in_an_answer_is_replaced() -> None:
    """A lone surrogate is no text in UTF-8, and would break every record and cassette after it."""
    reply = ask(model(lambda *_: ModelResponse(parts=[TextPart("Position: \ud800 [1, 2] ☃")])))
    assert reply.text == "Position: ? [1, 2] ☃"


def test_no_key_leaves_as_the_name_of_the_model() -> None:
    """A local server may echo what it was sent as its model's name."""

    async def answer(messages: list[ModelMessage], info: AgentInfo) -> ModelResponse:
        return ModelResponse(parts=[TextPart("Position: [1, 2]")])

    echo = FunctionModel(answer, model_name=f"authorization=Bearer {KEY} " + "x" * 1000)
    reply = ask(PydanticModel(echo, name="openai:o3-mini", secrets=(KEY,)))
    assert KEY not in reply.model and len(reply.model) < 150


def test_a_text_that_is_none_is_a_failed_call() -> None:
    """Anthropic's library passes on `"text": null`."""

    def nothing(messages: list[ModelMessage], info: AgentInfo) -> ModelResponse:
        return ModelResponse(parts=[TextPart(content=cast("str", None))])

    with pytest.raises(ModelError, match="garbage: TypeError while reading the response"):
        ask(PydanticModel(FunctionModel(nothing), name="anthropic:x"))


def test_any_exception_of_an_sdk_is_a_failed_call() -> None:
    """pydantic-ai raises RuntimeError at custom tool calls."""

    def trip(messages: list[ModelMessage], info: AgentInfo) -> ModelResponse:
        raise RuntimeError("Custom tool calls are not supported")

    with pytest.raises(ModelError, match="garbage: RuntimeError while reading the response"):
        asyncio.run(model(trip).ask(call()))


@pytest.mark.parametrize(("answers_as", "said"), [("o3-mini-2025-01-31", 0), ("another.gguf", 1)])
def test_a_server_that_answers_to_any_name_is_named(
    answers_as: str, said: int, caplog: pytest.LogCaptureFixture
) -> None:
    async def answer(messages: list[ModelMessage], info: AgentInfo) -> ModelResponse:
        return ModelResponse(parts=[TextPart("Position: [1, 2]")])

    asked = PydanticModel(FunctionModel(answer, model_name=answers_as), name="openai:o3-mini")
    for _ in range(2):
        assert ask(asked).model == f"openai:{answers_as}"
    assert sum("answers as another.gguf" in text for text in caplog.messages) == said
