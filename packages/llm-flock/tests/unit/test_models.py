"""Names of models, ranges over robots, settings, addresses, keys."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from llm_flock.errors import InputError
from llm_flock.llm._client import CallSettings
from llm_flock.llm._models import ModelPool, check_priced, parse_models, parse_settings, per_robot
from llm_flock.llm._port import Usage
from llm_flock.llm._providers import cost_usd, parse_base_urls, parse_model
from llm_flock.llm._replay import CassetteLine
from llm_flock.llm._simulated.model import SimulatedModel
from llm_flock.record._schema import LlmEntry

RNG = np.random.default_rng(0)


def test_other_kinds_of_models() -> None:
    assert parse_model("geometry").kind == "geometry"
    replay = parse_model("replay:runs/a=b, c.jsonl")
    assert (replay.kind, replay.model) == ("replay", "runs/a=b, c.jsonl")
    simulated = parse_model("simulated:distorted@0.3,overshoot@0.3")
    assert (simulated.kind, simulated.model) == ("simulated", "distorted@0.3,overshoot@0.3")
    assert parse_model("ollama:qwen3:8b").model == "qwen3:8b"


@pytest.mark.parametrize(
    "text", ["", "gpt", "nobody:x", "openai:", "simulated:", "replay:", "openai:a b", "openai:a,b"]
)
def test_a_bad_model_string_says_what_exists(text: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_model(text)
    assert caught.value.field == "model"


def test_models_per_robot() -> None:
    assert parse_models("geometry", 3) == ("geometry",) * 3
    assert parse_models("2=openai:b, 0-1=openai:a", 3) == ("openai:a", "openai:a", "openai:b")
    mixed = parse_models("0-1=simulated:distorted@0.3,overshoot@0.3,2-3=ollama:qwen3:8b", 4)
    assert mixed == ("simulated:distorted@0.3,overshoot@0.3",) * 2 + ("ollama:qwen3:8b",) * 2
    assert parse_models("0=geometry,1-=openai:a", 3) == ("geometry", "openai:a", "openai:a")
    assert parse_models("2 - =geometry,0-1=openai:a", 3) == ("openai:a", "openai:a", "geometry")
    assert parse_models("simulated:distorted@0.3,overshoot@0.3", 1) == ("simulated:distorted@0.3,overshoot@0.3",)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("0-1=geometry,1-2=geometry", "robot 1 is named twice"),
        ("0=geometry", "none for 1, 2"),
        ("0-3=geometry", "within 0..2"),
        ("2-0=geometry", "within 0..2"),
        ("3-=geometry", "within 0..2"),
        ("0-=geometry,2=geometry", "robot 2 is named twice"),
        ("0-2=", "value after"),
        ("0-2=nobody:x", "unknown provider 'nobody'"),
        ("0-1=openai:a,2=", "value after"),
        ("0-2=openai:a,2", "without spaces, commas"),
    ],
)
def test_bad_ranges_say_what_is_wrong(text: str, says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        parse_models(text, 3)
    assert caught.value.field == "model"


def test_settings_per_robot() -> None:
    assert parse_settings(2) == (CallSettings(), CallSettings())
    got = parse_settings(3, temperature="0-1=0.2,2=1", seed="7", reasoning="2=high,0-1=none")
    assert got[0] == CallSettings(temperature=0.2, seed=7, reasoning="none")
    assert got[2].plain() == {"temperature": 1.0, "seed": 7, "reasoning": "high"}
    assert parse_settings(2, max_tokens=500, seed="1") == (CallSettings(seed=1, max_tokens=500),) * 2


@pytest.mark.parametrize(
    ("field", "text"),
    [
        ("temperature", "hot"),
        ("temperature", "2.1"),
        ("temperature", "nan"),
        ("seed", "1.5"),
        ("seed", "-1"),
        ("reasoning", "hard"),
    ],
)
def test_a_bad_setting_names_itself(field: str, text: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_settings(1, max_tokens=None, **{field: text})
    named = {"temperature": "temperature", "seed": "model_seed", "reasoning": "reasoning_effort"}
    assert (caught.value.field, caught.value.value) == (named[field], text), "as the configuration calls it"


def test_base_urls() -> None:
    assert parse_base_urls(None, ["openai:a", "geometry"]) == {}
    assert parse_base_urls("http://h:8000/v1/", ["llama:a", "llama:b"]) == {"llama": "http://h:8000/v1"}
    both = parse_base_urls("llama=http://h/v1,vllm=https://g", ["llama:a", "vllm:b", "openai:c"])
    assert both == {"llama": "http://h/v1", "vllm": "https://g"}
    assert parse_base_urls("http://h/v1", ["simulated:ideal"]) == {}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "an address for 'llama'"),
        ("localhost:8000", "http://HOST"),
        ("ftp://h", "http://HOST"),
        ("http://h:port", "http://HOST"),
        ("http://", "http://HOST"),
        ("vllm=http://h", "a provider in use: llama"),
    ],
)
def test_bad_base_urls(text: str | None, says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        parse_base_urls(text, ["llama:a"])
    assert caught.value.field == "base_url"


def test_one_address_for_two_providers_is_refused() -> None:
    """Otherwise the key of the one would travel to the other."""
    with pytest.raises(InputError, match="provider=URL"):
        parse_base_urls("http://h/v1", ["openai:a", "llama:b"])


def test_password_in_an_address_is_refused_but_not_repeated() -> None:
    with pytest.raises(InputError) as caught:
        parse_base_urls("http://me:hunter2@h/v1", ["llama:a"])
    assert "hunter2" not in str(caught.value)


def test_prices() -> None:
    usage = Usage(input=1_000_000, output=100_000, cached=400_000)
    # o3-mini: 1.10 in, 0.55 cached, 4.40 out [US dollars per million tokens]
    assert cost_usd("openai", "o3-mini", usage) == pytest.approx(0.6 * 1.10 + 0.4 * 0.55 + 0.1 * 4.40)
    assert cost_usd("openai", "model-of-tomorrow", usage) is None
    assert cost_usd(None, "o3-mini", usage) is None
    assert cost_usd("openai-responses", "o3-mini", usage) == cost_usd("openai", "o3-mini", usage)
    assert cost_usd("deepseek", "deepseek-reasoner", usage) is not None


def test_a_money_budget_needs_prices() -> None:
    check_priced(None, ["ollama:x"], {})
    check_priced(1.0, ["openai:o3-mini", "simulated:ideal", "geometry"], {})
    with pytest.raises(InputError, match="ollama:x"):
        check_priced(1.0, ["openai:o3-mini", "ollama:x"], {})
    with pytest.raises(InputError, match="openai:o3-mini"):
        check_priced(1.0, ["openai:o3-mini"], {"openai": "http://localhost/v1"})


def test_simulated_models_and_others_have_doors_of_their_own() -> None:
    pool = ModelPool(environ={})
    model = pool.model("simulated:ideal", rng=np.random.default_rng(0))
    assert model.name == "simulated:ideal"
    assert isinstance(model, SimulatedModel)
    for text in ("geometry", "replay:x"):
        with pytest.raises(InputError, match="expected no replay, geometry or class here"):
            pool.model(text, rng=np.random.default_rng(0))


def test_per_robot_names_the_field_it_was_asked_about() -> None:
    with pytest.raises(InputError) as caught:
        per_robot("temperature", "9=1", 3)
    assert caught.value.field == "temperature"


DOCS = Path(__file__).parents[4] / "docs" / "reference" / "cassette.md"


def test_cassette_has_the_documented_fields_of_a_recorded_call() -> None:
    assert CassetteLine.model_fields.keys() - {"answer_schema"} == LlmEntry.model_fields.keys() - {"probe"}
    assert "without `probe`, and with `answer_schema`" in DOCS.read_text(encoding="utf-8")


def test_a_query_in_an_address_is_refused_without_repeating_it() -> None:
    with pytest.raises(InputError) as caught:
        parse_base_urls("http://127.0.0.1:9/v1?api-key=SECRET", ["openai:o3-mini"])
    assert caught.value.field == "base_url" and "SECRET" not in str(caught.value)
