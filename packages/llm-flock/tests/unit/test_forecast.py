"""What a run is expected to use, by a rehearsal."""

from __future__ import annotations

from typing import Any

import pytest
from typer.testing import CliRunner

from llm_flock.cli import app
from llm_flock.runtime._api import run
from llm_flock.runtime._config import RunConfig, build_config
from llm_flock.runtime._forecast import Expected, expect_run, priced, stand_in


def team(**fields: Any) -> RunConfig:
    return build_config({}, **{"shape": "circle", "n_robots": 6, "model": "simulated:ideal"} | fields)


def test_a_run_that_computes_is_its_own_rehearsal() -> None:
    config = team()
    flown = run(config=config, progress=False, trace=False).summary
    found = expect_run(config)
    assert (found.calls, found.cost_usd) == (flown.model_calls, 0.0)
    assert (found.tokens_input, found.tokens_output) == pytest.approx((flown.tokens_input, flown.tokens_output))


def test_real_model_is_rehearsed_for_free_with_same_questions() -> None:
    config = team(model="openai:gpt-4o", max_calls=50, max_cost=1.0, temperature="0.5", record_llm="x.jsonl")
    double = stand_in(config, "ideal")
    assert double.model.model == "simulated:ideal" and double.mission == config.mission
    assert (double.limits.max_calls, double.limits.max_cost, double.model.record_llm) == (None, None, None)
    assert expect_run(config).at_most == 50
    assert stand_in(team()).model == team().model


def test_each_robot_pays_its_own_price() -> None:
    used = Expected(calls=60.0, tokens_input=6000.0, tokens_output=90.0)
    mixed = priced(team(model="0-2=geometry,3=simulated:ideal,4-5=openai:gpt-4o"), used, 100)
    assert (mixed.calls, mixed.tokens_input) == pytest.approx((30.0, 3000.0))
    assert mixed.tokens_output == pytest.approx(10 * 1.5 + 20 * 100)
    assert mixed.cost_usd == pytest.approx(20 * (100 * 2.5e-6 + 100 * 1e-5))
    for model in ("my.module:Model", "vllm:x", "0-4=simulated:ideal,5=openai:no-such-model"):
        assert priced(team(model=model), used).cost_usd is None
    assert expect_run(team(model="geometry")).calls == 0


def test_the_command_says_what_it_assumed() -> None:
    line = ("run", "--shape", "circle", "--robots", "6", "--dry-run", "--model", "openai:gpt-4o", "--max-calls", "900")
    text = " ".join(CliRunner().invoke(app, line).stdout.split())
    assert "at most 900" in text and "Assumed: 400 tokens an answer" in text and "Budget: 900 calls." in text
