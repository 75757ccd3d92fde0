"""Any reply of a provider is an answer or a failed call, through the real clients of the providers."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import AsyncIterator

import httpx2
import pytest
from anthropic.types import Message
from hostile import Hostile, damaged, drawn, seeds
from integration.fault_server import completion
from mangled import tried
from openai.types.chat import ChatCompletion

from llm_flock.errors import ModelError
from llm_flock.llm._client import PydanticModel
from llm_flock.llm._hosted import build_model, new_http_client
from llm_flock.llm._port import Call, ChatMessage

CALL = Call(
    robot=0, round=1, kind="step", attempt=0, messages=(ChatMessage("system", "a robot"), ChatMessage("user", "go"))
)


GOOD = {
    "openai": (ChatCompletion, json.loads(completion(b"", "Position: [1.0, 2.0]"))),
    "anthropic": (
        Message,
        {
            "id": "m",
            "type": "message",
            "role": "assistant",
            "model": "stand-in",
            "content": [{"type": "text", "text": "Position: [1.0, 2.0]"}],
            "stop_reason": "end_turn",
            "stop_sequence": None,
            "usage": {"input_tokens": 1, "output_tokens": 2},
        },
    ),
}
"""Types of a provider's reply in its own library, and a good one."""


@pytest.mark.filterwarnings("ignore::pydantic_ai._warnings.UsageExtractionFailedWarning")
@pytest.mark.parametrize("part", range(4))
@pytest.mark.parametrize("provider", ["openai-compatible", "ollama", "openai", "anthropic"])
def test_any_reply_is_an_answer_or_a_failed_call(provider: str, part: int) -> None:
    kind, good = GOOD.get(provider, GOOD["openai"])
    http = new_http_client()
    http._mounts = {}
    built = build_model(provider, "some-model", base_url="http://127.0.0.1:9/v1", key="k", http=http, timeout_s=5.0)
    model = PydanticModel(built, name="x:y")
    answered = 0

    async def ask(reply: httpx2.Response) -> None:
        http._transport = httpx2.MockTransport(lambda request: reply)
        found = await model.ask(CALL)
        assert isinstance(found.text, str) and found.usage.total >= 0
        assert math.isfinite(found.latency_s) and found.text.encode() is not None

    with asyncio.Runner() as runner:
        for seed in seeds(provider, 50, part, 4):
            with drawn(seed) as rng:
                body = json.dumps(Hostile(rng).model(kind, good), ensure_ascii=rng.random() < 0.5)
                body = damaged(body.encode("utf-8", "surrogatepass"), rng)
                status = rng.choice((200, 200, 200, 200, 429, 500, 302, 204))
                media = rng.choice(("application/json", "application/json", "text/html", "\x7f"))
                reply = httpx2.Response(
                    status, content=body, headers={"content-type": media, "retry-after": rng.choice(RETRY)}
                )
                answered += tried(lambda reply=reply: runner.run(ask(reply)), ModelError) is None
        runner.run(http.aclose())
    assert answered


RETRY = ("1", "-5", "1e999", "nan", "Thu, 01 Jan 1970 00:00:00 GMT", "x", "999999999999999999999999")


@pytest.mark.parametrize("charset", ["punycode", "hex", "rot13", "undefined"])
def test_a_server_does_not_choose_how_its_words_are_read(charset: str) -> None:
    """Python's punycode takes minutes for a megabyte, in which no robot of the run is served."""
    headers = {"content-type": f"text/plain; charset={charset}"}
    body = b"a-" + b"z" * 100_000

    async def ask() -> None:
        http = new_http_client()
        http._mounts = {}
        http._transport = httpx2.MockTransport(lambda request: httpx2.Response(500, stream=Stream(), headers=headers))
        async with http:
            model = build_model(
                "openai-compatible", "m", base_url="http://127.0.0.1:9/v1", key="k", http=http, timeout_s=5.0
            )
            await PydanticModel(model, name="x:y").ask(CALL)

    class Stream(httpx2.AsyncByteStream):
        async def __aiter__(self) -> AsyncIterator[bytes]:
            yield body

    with pytest.raises(ModelError, match=r"server: .*zzz"):
        asyncio.run(ask())
