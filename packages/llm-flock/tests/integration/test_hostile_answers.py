"""Any reply of a provider is an answer or a failed call, through the real clients of the providers."""

from __future__ import annotations

import asyncio
import math
import random
from collections.abc import AsyncIterator

import httpx2
import pytest
from effort import cases
from hypothesis import given
from hypothesis import strategies as st
from integration.fault_server import completion
from mangled import mangled_json, tried

from llm_flock.errors import ModelError
from llm_flock.llm._client import PydanticModel
from llm_flock.llm._hosted import build_model, new_http_client
from llm_flock.llm._port import Call, ChatMessage

CALL = Call(
    robot=0, round=1, kind="step", attempt=0, messages=(ChatMessage("system", "a robot"), ChatMessage("user", "go"))
)


@pytest.mark.filterwarnings("ignore::pydantic_ai._warnings.UsageExtractionFailedWarning")
@cases(25)
@given(seed=st.integers(0, 2**63), provider=st.sampled_from(["openai-compatible", "ollama", "openai"]))
def test_any_reply_of_a_provider_is_an_answer_or_a_failed_call(seed: int, provider: str) -> None:
    rng = random.Random(seed)
    body = mangled_json(completion(b"", "Position: [1.0, 2.0]"), rng)
    status = rng.choice((200, 200, 200, 200, 429, 500, 302, 204))
    headers = {"content-type": rng.choice(("application/json", "text/html", "\x7f")), "retry-after": rng.choice(RETRY)}

    async def ask() -> None:
        http = new_http_client()
        http._mounts = {}
        http._transport = httpx2.MockTransport(lambda request: httpx2.Response(status, content=body, headers=headers))
        async with http:
            model = PydanticModel(
                build_model(
                    provider, "some-model", base_url="http://127.0.0.1:9/v1", key="k", http=http, timeout_s=5.0
                ),
                name="x:y",
            )
            reply = await model.ask(CALL)
            assert isinstance(reply.text, str) and reply.usage.total >= 0
            assert math.isfinite(reply.latency_s) and reply.text.encode() is not None

    tried(lambda: asyncio.run(ask()), ModelError)


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
