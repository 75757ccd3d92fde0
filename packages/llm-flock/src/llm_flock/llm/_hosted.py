"""pydantic-ai models of real providers, with our own HTTP client and without the SDKs' retries.

This module imports the SDKs, which takes most of a second: import it only where a provider is needed.
"""

from __future__ import annotations

import os
from collections.abc import AsyncIterator, Generator
from contextlib import contextmanager
from http.cookiejar import CookieJar, DefaultCookiePolicy
from typing import Any

import httpx2
from pydantic_ai.models import Model

from llm_flock.errors import FieldError, InputError
from llm_flock.llm._hosted_body import chat_completion
from llm_flock.llm._providers import LOOPBACK, PROVIDERS

MAX_ANSWER_BYTES = 2 << 20
"""Largest body of a response [bytes]: more than twice the longest answers of today's models. JSON can take sixty times
as much memory."""


class _LimitedBody(httpx2.AsyncByteStream):
    """A response's body that fails at MAX_ANSWER_BYTES."""

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


async def _make_safe(response: httpx2.Response) -> None:
    """Reject a response before it fills the memory: one that is too large, or compressed. Chat completions are read."""
    packed = response.headers.get("content-encoding", "identity")
    if packed != "identity":
        raise httpx2.DecodingError(f"the response is compressed ({packed[:20]}), which was not asked for")
    assert isinstance(response.stream, httpx2.AsyncByteStream)
    response.stream = _LimitedBody(response.stream)
    if response.status_code == 200 and response.request.url.path.endswith("/chat/completions"):
        try:
            body = b"".join([chunk async for chunk in response.stream])
        finally:
            await response.stream.aclose()  # gives the connection back
        response.status_code, plain = chat_completion(body)
        response.headers["content-type"] = "application/json"
        response.headers["content-length"] = str(len(plain))
        response.stream = httpx2.ByteStream(plain)
    # All these protocols are UTF-8. Some codecs of Python take hours for a megabyte (punycode), or give no text.
    response.encoding = "utf-8"


def new_http_client() -> httpx2.AsyncClient:
    """One client for all models, with connections for any number of calls at once.

    Compressed responses, which can unpack to gigabytes, are refused; keys follow no redirect, no proxy to this host. No
    cookie is kept: another server would get it.
    """
    try:
        return httpx2.AsyncClient(
            follow_redirects=False,
            mounts={f"all://{f'[{host}]' if ':' in host else host}": None for host in LOOPBACK},
            limits=httpx2.Limits(max_connections=None, max_keepalive_connections=None),
            headers={"Accept-Encoding": "identity"},
            cookies=CookieJar(DefaultCookiePolicy(allowed_domains=[])),
            event_hooks={"response": [_make_safe]},
        )
    except (ImportError, ValueError) as error:
        says = f"the proxy that HTTP_PROXY, HTTPS_PROXY or ALL_PROXY names cannot be used: {error}"
        raise FieldError("proxy", says=says) from None


@contextmanager
def _unseen(*kept: str) -> Generator[None]:
    """Hide the SDKs' variables, all but those `kept`: they would send some, as headers, to any address."""
    mine = [name for name in os.environ if name.startswith(("OPENAI_", "ANTHROPIC_")) and name not in kept]
    hidden = {name: os.environ.pop(name) for name in mine}
    try:
        yield
    finally:
        os.environ.update(hidden)


def build_model(
    provider: str, model: str, *, base_url: str, key: str, http: httpx2.AsyncClient, timeout_s: float
) -> Model[Any]:
    """The pydantic-ai model for a provider, without the SDKs' retries: they would hide faults from the record."""
    try:
        httpx2.URL(base_url)
    except httpx2.InvalidURL as error:
        raise InputError("base_url", base_url, f"an address of HTTP ({error})") from None
    options: dict[str, Any] = {
        "api_key": key or "no-key",  # OpenAI's SDK rejects an empty key; servers that need no key ignore it
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

        # The system message is the same for all questions of a team, so Anthropic can read it from its cache.
        settings = AnthropicModelSettings(anthropic_cache_instructions=True)
        with _unseen():
            client = AsyncAnthropic(**options)
        return AnthropicModel(model, provider=AnthropicProvider(anthropic_client=client), settings=settings)
    from llm_flock.llm._hosted_openai import build_openai_model

    own = ("OPENAI_ORG_ID", "OPENAI_PROJECT_ID") if base_url == PROVIDERS["openai"].base_url else ()
    with _unseen(*own):
        return build_openai_model(provider, model, options)
