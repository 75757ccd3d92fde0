"""Models of real providers, built with the SDKs of the extras openai and anthropic."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from pydantic_ai.models.openai import OpenAIResponsesModel

from llm_flock.errors import InputError
from llm_flock.llm._client import PydanticModel
from llm_flock.llm._models import ModelPool
from llm_flock.llm._providers import PROVIDERS, needs_responses, parse_model

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("info", PROVIDERS.values(), ids=lambda info: info.name)
def test_every_provider_in_the_table_can_be_built(info) -> None:
    """The example parses, and the pydantic-ai model behind it comes to life without a network."""
    name = parse_model(info.example)
    assert (name.kind, name.provider, name.info) == ("provider", info.name, info)

    async def build() -> str:
        urls = {} if info.base_url else {info.name: "http://localhost:9/v1"}
        async with ModelPool(environ={info.key_env: "key-0123456789"}) as pool:
            first = pool.model(info.example, rng=np.random.default_rng(0), base_urls=urls)
            second = pool.model(info.example, rng=np.random.default_rng(1), base_urls=urls)
            other = pool.model(info.example, rng=RNG, base_urls={info.name: "http://localhost:8/v1"})
            assert isinstance(first, PydanticModel) and isinstance(second, PydanticModel)
            assert first._model is second._model  # one model, one set of connections, for all robots
            assert isinstance(other, PydanticModel) and other._model is not first._model  # at another address
            assert first._model.model_name == name.model
            assert first._model.client.max_retries == 0  # pyright: ignore[reportAttributeAccessIssue]
            return first.name

    assert asyncio.run(build()) == info.example


@pytest.mark.parametrize(
    ("model", "own", "elsewhere"),
    [
        ("openai-responses:gpt-5-mini", True, True),
        ("openai:o3-pro", True, False),
        ("openai:o1-pro-2025-03-19", True, False),
        ("openai:gpt-5.2-pro", True, False),
        ("openai:gpt-5-codex", True, False),
        ("openai:codex-mini-latest", True, False),
        ("openai:o4-mini-deep-research", True, False),
        ("openai:o3-mini", False, False),
        ("openai:gpt-5", False, False),
        ("openai:prose", False, False),
        ("vllm:o3-pro", False, False),
    ],
)
def test_responses_api_is_used_for_models_without_another(model: str, own: bool, elsewhere: bool) -> None:
    name = parse_model(model)
    if name.info.base_url and name.provider.startswith("openai"):
        asked = ModelPool(environ={"OPENAI_API_KEY": "k"}).model(model, rng=np.random.default_rng(0))
        assert isinstance(asked, PydanticModel) and isinstance(asked._model, OpenAIResponsesModel) == own
    assert needs_responses(name.provider, name.model, name.info.base_url or "") == own
    assert needs_responses(name.provider, name.model, "http://localhost:9/v1") == elsewhere


def test_a_missing_key_names_its_variable() -> None:
    for info in PROVIDERS.values():
        pool, urls = ModelPool(environ={}), {} if info.base_url else {info.name: "http://localhost:9"}
        if info.key_required:
            with pytest.raises(InputError, match=info.key_env):
                pool.model(info.example, rng=RNG, base_urls=urls)
        else:
            assert pool.model(info.example, rng=RNG, base_urls=urls).name == info.example


def test_other_address_needs_no_key_and_none_is_invented() -> None:
    ModelPool(environ={}).model("openai:o3-mini", rng=RNG, base_urls={"openai": "http://localhost:9/v1"})
    with pytest.raises(InputError, match="an address for 'llama'"):
        ModelPool(environ={}).model("llama:any", rng=RNG)
