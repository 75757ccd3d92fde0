"""pydantic-ai models of real providers, with our own HTTP client and without any retries below us.

This module imports the providers' SDKs, which takes most of a second: import it only where one is needed.
"""

from __future__ import annotations

from typing import Any

import httpx2
from anthropic import AsyncAnthropic
from openai import AsyncOpenAI
from pydantic_ai.models import Model
from pydantic_ai.models.anthropic import AnthropicModel
from pydantic_ai.models.ollama import OllamaModel
from pydantic_ai.models.openai import OpenAIChatModel
from pydantic_ai.profiles.openai import OpenAIModelProfile
from pydantic_ai.providers import Provider
from pydantic_ai.providers.alibaba import AlibabaProvider
from pydantic_ai.providers.anthropic import AnthropicProvider
from pydantic_ai.providers.deepseek import DeepSeekProvider
from pydantic_ai.providers.ollama import OllamaProvider
from pydantic_ai.providers.openai import OpenAIProvider
from pydantic_ai.providers.openai_compatible import OpenAICompatibleProvider
from pydantic_ai.providers.vllm import VLLMProvider

CONNECT_TIMEOUT_S = 10.0
MAX_CONNECTIONS = 4096
"""More than any team has robots: how many calls run at once is decided in `limits`, not by the connection pool."""

NO_KEY = "no-key"
"""The OpenAI SDK refuses an empty key; servers that need none ignore this one."""


def new_http_client(timeout_s: float) -> httpx2.AsyncClient:
    """One client for all models: idle connections are kept, and none is ever waited for.

    httpx2's defaults (100 connections, 20 kept alive) would make the 101st robot queue, and the wait for a
    connection would count as the model's.
    """
    return httpx2.AsyncClient(
        timeout=httpx2.Timeout(timeout_s, connect=min(CONNECT_TIMEOUT_S, timeout_s), pool=None),
        limits=httpx2.Limits(max_connections=MAX_CONNECTIONS, max_keepalive_connections=MAX_CONNECTIONS),
    )


def build_model(provider: str, model: str, *, base_url: str, key: str | None, http: httpx2.AsyncClient) -> Model[Any]:
    """The pydantic-ai model for a provider of the table in `providers`.

    The SDKs' own retries (2 by default) are switched off: they would hide faults from the record, and give up where
    `limits` still waits.
    """
    if provider == "anthropic":
        client = AsyncAnthropic(
            api_key=key or NO_KEY, base_url=base_url, http_client=http, max_retries=0, timeout=http.timeout
        )
        return AnthropicModel(model, provider=AnthropicProvider(anthropic_client=client))
    openai = AsyncOpenAI(
        api_key=key or NO_KEY, base_url=base_url, http_client=http, max_retries=0, timeout=http.timeout
    )
    if provider == "ollama":
        return OllamaModel(model, provider=OllamaProvider(openai_client=openai))
    return OpenAIChatModel(model, provider=_openai_like(provider, openai))


def _openai_like(provider: str, client: AsyncOpenAI) -> Provider[AsyncOpenAI]:
    """The pydantic-ai provider that knows the peculiarities of a service."""
    match provider:
        case "openai":
            return OpenAIProvider(openai_client=client)
        case "deepseek":
            return DeepSeekProvider(openai_client=client)
        case "qwen":
            return AlibabaProvider(openai_client=client)
        case "vllm":
            return VLLMProvider(openai_client=client)
        case _:
            # Anyone's server: it knows `max_tokens`, the older and wider spread of the two names.
            profile = OpenAIModelProfile(openai_chat_supports_max_completion_tokens=False)
            return OpenAICompatibleProvider(provider, openai_client=client, profile=profile)
