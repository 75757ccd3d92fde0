"""pydantic-ai models of real providers, with our own HTTP client and without retries of theirs.

Imports the providers' SDKs, which takes most of a second: import this module only where a provider is needed.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

import httpx2
from pydantic_ai.models import Model

MAX_ANSWER_BYTES = 2 << 20
"""Largest body of a response that is read [bytes]: more than twice the longest answers of today's models. Read as JSON,
it can take sixty times as much memory."""


class _Bounded(httpx2.AsyncByteStream):
    """A response's body, which fails instead of growing beyond the limit."""

    def __init__(self, body: httpx2.AsyncByteStream) -> None:
        self._body = body

    async def __aiter__(self) -> AsyncIterator[bytes]:
        read = 0
        async for chunk in self._body:
            read += len(chunk)
            if read > MAX_ANSWER_BYTES:
                raise httpx2.DecodingError(f"the response is larger than {MAX_ANSWER_BYTES >> 20} MiB")
            yield chunk

    async def aclose(self) -> None:
        await self._body.aclose()


async def _bound(response: httpx2.Response) -> None:
    """Refuse a response before it fills the memory: by its size, also of what is packed in few bytes."""
    packed = response.headers.get("content-encoding", "identity")
    if packed != "identity":
        raise httpx2.DecodingError(f"the response is compressed ({packed[:20]}), which was not asked for")
    assert isinstance(response.stream, httpx2.AsyncByteStream)
    response.stream = _Bounded(response.stream)
    # All these protocols are UTF-8. Python has codecs that take hours for a megabyte (punycode), or give no text.
    response.encoding = "utf-8"


def new_http_client() -> httpx2.AsyncClient:
    """One client for all models, with connections for any number of calls at once.

    A response has at most `MAX_ANSWER_BYTES`, and is not compressed: a few kilobytes can unpack to gigabytes.
    """
    return httpx2.AsyncClient(
        limits=httpx2.Limits(max_connections=None, max_keepalive_connections=None),
        headers={"Accept-Encoding": "identity"},
        event_hooks={"response": [_bound]},
    )


def build_model(
    provider: str, model: str, *, base_url: str, key: str, http: httpx2.AsyncClient, timeout_s: float
) -> Model[Any]:
    """The pydantic-ai model for a provider of the table in `providers`.

    The SDKs' own retries are switched off: they would hide faults from the record, and give up earlier than `limits`.
    """
    options: dict[str, Any] = {
        "api_key": key or "no-key",  # OpenAI's SDK refuses an empty one; servers that need none ignore it
        "base_url": base_url,
        "http_client": http,
        "max_retries": 0,
        "timeout": httpx2.Timeout(timeout_s, connect=min(10.0, timeout_s), pool=None),
    }
    if provider == "anthropic":
        # Its SDK takes longer to import than all the others together.
        from anthropic import AsyncAnthropic
        from pydantic_ai.models.anthropic import AnthropicModel, AnthropicModelSettings
        from pydantic_ai.providers.anthropic import AnthropicProvider

        # The system message is the same for the whole team and all its questions: it is read from the cache.
        settings = AnthropicModelSettings(anthropic_cache_instructions=True)
        client = AsyncAnthropic(**options)
        return AnthropicModel(model, provider=AnthropicProvider(anthropic_client=client), settings=settings)
    from llm_flock.llm._hosted_openai import build_openai_model

    return build_openai_model(provider, model, options)
