"""pydantic-ai models of OpenAI and of every server with its protocol. Needs the extra `openai`."""

from __future__ import annotations

from typing import Any

from openai import AsyncOpenAI
from pydantic_ai.models import Model
from pydantic_ai.models.ollama import OllamaModel
from pydantic_ai.models.openai import OpenAIChatModel, OpenAIResponsesModel, OpenAIResponsesModelSettings
from pydantic_ai.profiles.openai import OpenAIModelProfile
from pydantic_ai.providers.alibaba import AlibabaProvider
from pydantic_ai.providers.deepseek import DeepSeekProvider
from pydantic_ai.providers.ollama import OllamaProvider
from pydantic_ai.providers.openai import OpenAIProvider
from pydantic_ai.providers.openai_compatible import OpenAICompatibleProvider
from pydantic_ai.providers.vllm import VLLMProvider

from llm_flock.llm._providers import needs_responses

_WHOLE_TEXT = OpenAIModelProfile(thinking_tags=("<no answer holds this>", "</no answer holds this>"))
"""pydantic-ai would split `<think>...</think>` off, but would pass on an unfinished thought without its mark."""

_ANY_SERVER: OpenAIModelProfile = {**_WHOLE_TEXT, "openai_chat_supports_max_completion_tokens": False}
"""`max_tokens` is the older name of the setting, and more servers know it."""

_OPENAI_LIKE = {"openai": OpenAIProvider, "deepseek": DeepSeekProvider, "qwen": AlibabaProvider, "vllm": VLLMProvider}
"""pydantic-ai providers that know the peculiarities of a service."""


def build_openai_model(provider: str, model: str, options: dict[str, Any]) -> Model[Any]:
    """The pydantic-ai model for a provider of the table; `options` are those of the SDK's client."""
    openai = AsyncOpenAI(**options)
    if needs_responses(provider, model, options["base_url"]):
        # Conversations are sent whole, so nothing has to stay on the provider's servers.
        stateless = OpenAIResponsesModelSettings(openai_store=False)
        return OpenAIResponsesModel(model, provider=OpenAIProvider(openai_client=openai), settings=stateless)
    if provider == "ollama":
        ollama = OllamaProvider(openai_client=openai)
        # With a profile of ours, the class does not find out what Ollama's cloud lacks.
        schemas = OllamaModel(model, provider=ollama).profile.get("supports_json_schema_output", False)
        return OllamaModel(model, provider=ollama, profile={**_ANY_SERVER, "supports_json_schema_output": schemas})
    known = _OPENAI_LIKE.get(provider)
    if known is not None:
        profile = _WHOLE_TEXT if provider == "openai" else _ANY_SERVER
        return OpenAIChatModel(model, provider=known(openai_client=openai), profile=profile)
    compatible = OpenAICompatibleProvider(provider, openai_client=openai)
    return OpenAIChatModel(model, provider=compatible, profile=_ANY_SERVER)
