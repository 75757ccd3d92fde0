"""A provider's key goes to its own host, to this machine, and where the operator says; nowhere else."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from llm_flock.errors import InputError
from llm_flock.llm._models import ModelPool
from llm_flock.llm._providers import PROVIDERS, SEND_KEY_TO
from llm_flock.runtime import TeamPlanners, check_planners
from llm_flock.runtime._config import RunConfig, load_config
from llm_flock_lab._experiments.sweep_file import load_sweep
from llm_flock_swarm._network.config import SwarmConfig

KEY = {"OPENAI_API_KEY": "sk-secret", "VLLM_API_KEY": "sk-mine"}
ELSEWHERE = "https://elsewhere.example/v1"


@pytest.mark.parametrize(
    ("provider", "url", "environ", "typed", "says"),
    [
        ("openai", PROVIDERS["openai"].base_url, {}, False, ""),
        ("openai", ELSEWHERE, {}, False, "type --base-url yourself or export LLM_FLOCK_SEND_KEY_TO=elsewhere.example"),
        ("openai", ELSEWHERE, {SEND_KEY_TO: "other.example"}, False, "to send OPENAI_API_KEY to elsewhere.example"),
        ("openai", ELSEWHERE, {SEND_KEY_TO: "other.example, Elsewhere.example"}, False, ""),
        ("openai", ELSEWHERE, {}, True, ""),
        ("openai", "https://api.openai.com.elsewhere.example", {}, False, "to send OPENAI_API_KEY to api.openai.com.e"),
        ("openai", "http://api.openai.com/v1", {}, True, "OPENAI_API_KEY would go to api.openai.com in plain text"),
        ("vllm", "http://gpu:8000/v1", {SEND_KEY_TO: "gpu"}, True, "VLLM_API_KEY would go to gpu in plain text"),
        ("vllm", "http://127.0.0.1.elsewhere.example/v1", {}, True, "in plain text: use https, or unset VLLM_API_KEY"),
        *(("vllm", f"http://{host}:8000/v1", {}, False, "") for host in ("localhost", "127.0.0.1", "[::1]")),
        ("vllm", "http://gpu:8000/v1", {"VLLM_API_KEY": " "}, False, ""),
    ],
)
def test_where_a_key_may_go(provider: str, url: str, environ: dict[str, str], typed: bool, says: str) -> None:
    pool, rng = ModelPool(environ=KEY | environ), np.random.default_rng(0)
    if not says:
        pool.model(f"{provider}:any", rng=rng, base_urls={provider: url}, typed=typed)
        return
    with pytest.raises(InputError, match=says) as caught:
        pool.model(f"{provider}:any", rng=rng, base_urls={provider: url}, typed=typed)
    assert caught.value.field == "base_url" and caught.value.value == url


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("OPENAI_API_KEY", "sk-secret")
    path = tmp_path / "run.toml"
    path.write_text(
        f'[mission]\nshape = "triangle"\nn_robots = 3\n[model]\nmodel = "openai:a"\nbase_url = "{ELSEWHERE}"\n'
    )
    return path


def test_an_address_that_only_a_file_names_gets_no_key(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"to send OPENAI_API_KEY to elsewhere\.example, type --base-url"):
        TeamPlanners(load_config(file))
    TeamPlanners(load_config(file, base_url=ELSEWHERE))
    monkeypatch.setenv(SEND_KEY_TO, "elsewhere.example")
    TeamPlanners(load_config(file))


def test_who_named_an_address_is_known_in_other_processes(file: Path) -> None:
    """Workers get a pickled configuration, the robots of a swarm its dump and what was typed."""
    for url in (None, ELSEWHERE):
        config = SwarmConfig.load(file, base_url=url)
        sent = SwarmConfig.build(config.model_dump(mode="json"), base_url=config.model.typed_url)
        for other in (pickle.loads(pickle.dumps(config)), sent, config.model_copy(update={"links": config.links})):
            assert other.model.typed_url == url and other.model.base_url == ELSEWHERE
    stored, outside = RunConfig.stored(load_config(file, base_url=ELSEWHERE).model_dump())
    assert stored.model.typed_url is None and outside == ["base_url", "model"]


@pytest.mark.parametrize("where", ["grid", "run.model", "named"])
def test_an_address_in_a_sweep_is_a_files_word(where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "sk-secret")
    axis = f'url = [{{ name = "a", base_url = "{ELSEWHERE}" }}]' if where == "named" else f'base_url = ["{ELSEWHERE}"]'
    lines = [axis] if where != "run.model" else ["[run.model]", f'base_url = "{ELSEWHERE}"']
    head = ["[sweep]", 'name = "a"', "seeds = 1", "[grid]", 'team = ["triangle/3"]', 'model = ["openai:a"]']
    path = tmp_path / "sweep.toml"
    path.write_text("\n".join([*head, *lines]))
    (found,) = load_sweep(path).trials
    assert found.config.model.base_url == ELSEWHERE
    with pytest.raises(InputError, match=r"to send OPENAI_API_KEY to elsewhere\.example"):
        check_planners(found.config)
    check_planners(found.config, asks=False)
    (typed,) = load_sweep(path, base_url=ELSEWHERE).trials
    check_planners(typed.config)
