"""Forecasts of large teams: flown by small ones, and as near to the truth as what the large team does itself."""

from __future__ import annotations

import math
from typing import Any

import pytest

from llm_flock.errors import InputError
from llm_flock.experiments import smaller_rehearsal, sweep_forecast
from llm_flock.experiments.smaller_rehearsal import LARGE, SIZES, smaller_team
from llm_flock.experiments.sweep_file import ExpectTable
from llm_flock.experiments.sweep_forecast import Expected, expect_run
from llm_flock.runtime.api import run
from llm_flock.runtime.config import RunConfig, build_config

IDEAL = ExpectTable(profile="ideal")


def team(n: int, **fields: Any) -> RunConfig:
    side = round(20 * math.sqrt(n) + 100)
    given: dict[str, Any] = {
        "shape": "grid",
        "center": (side / 2, side / 2),
        "arena": ((0, 0), (side, side)),
        "model": "simulated:ideal",
    }
    return build_config({}, **given | {"n_robots": n} | fields)


def expected(config: RunConfig) -> Expected:
    return expect_run(config, IDEAL)[0]


def flown_sizes(config: RunConfig, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Sizes of the teams that fly for a forecast."""
    sizes: list[int] = []

    def note(flown: Any) -> Any:
        def fly(**options: Any) -> Any:
            sizes.append(options["config"].mission.n_robots)
            return flown(**options)

        return fly

    for module in (smaller_rehearsal, sweep_forecast):
        monkeypatch.setattr(module, "run", note(module.run))
    expected(config)
    return sizes


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """One team is enough to see crowding, and quicker."""
    monkeypatch.setattr(smaller_rehearsal, "CROWDS", (40,))


@pytest.mark.parametrize("model", ["openai:gpt-5-mini", "simulated:ideal"])
def test_two_thousand_robots_are_rehearsed_by_a_few(model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    config = team(2000, model=model, safe_distance=3)
    asked, *alone = flown_sizes(config, monkeypatch)
    assert asked in SIZES
    assert alone == [asked, 40], "these fly without a model"


def test_a_forecast_by_a_small_team_is_near_to_the_team_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    config = team(60)
    monkeypatch.setattr(sweep_forecast, "REHEARSAL_S", 600.0)
    itself = expected(config)
    monkeypatch.setattr(sweep_forecast, "REHEARSAL_S", 0.0)
    assert flown_sizes(config, monkeypatch)[0] == 60, "it is tried first"
    scaled = expected(config)
    assert scaled.calls != itself.calls, "it was not flown by the same team"
    assert scaled.calls == pytest.approx(itself.calls, rel=0.25)
    assert scaled.tokens_input / scaled.calls == pytest.approx(itself.tokens_input / itself.calls, rel=0.15)
    assert scaled.tokens_output / scaled.calls == pytest.approx(itself.tokens_output / itself.calls, rel=0.15)
    assert scaled.at_most == itself.at_most and scaled.cost_usd == itself.cost_usd == 0.0


@pytest.mark.parametrize(("shape", "n", "seed"), [("circle", 64, 1), ("square", 72, 2)])
def test_crowding_is_in_the_forecast(shape: str, n: int, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    config = team(n, shape=shape, seed=seed, center=(160, 160), arena=((0, 0), (320, 320)), rounds=600)
    real = run(config=config, progress=False, trace=False).summary.model_calls
    monkeypatch.setattr(sweep_forecast, "REHEARSAL_S", 0.0)
    monkeypatch.setattr(smaller_rehearsal, "CROWDS", (n,))
    assert expected(config).calls == pytest.approx(real, rel=0.2)
    monkeypatch.setattr(smaller_rehearsal, "CROWDS", ())
    assert expected(config).calls < 0.9 * real


def test_prompts_and_plans_grow_with_the_team() -> None:
    """A step's prompt holds the plan: about 15 characters, 4 tokens, for each place."""
    some, many = expected(team(400)), expected(team(1600))
    step = [found.tokens_input / found.calls for found in (some, many)]
    assert 3.5 * 1200 < step[1] - step[0] < 5.5 * 1200
    assert many.calls / 1600 > some.calls / 400, "they fly farther"
    assert many.calls < 0.2 * many.at_most


def test_a_run_of_so_many_rounds_is_expected_to_fly_them() -> None:
    found = expected(team(400, rounds=7, stop_when_formed=False))
    assert found.calls / 400 == pytest.approx(8.0), "a plan, and a step in each round"
    assert expected(team(400, model="geometry")).calls == 0


@pytest.mark.parametrize(
    "fields",
    [
        {"history": "last:2"},
        {"shape": "text:a smiling face"},
        {"model": ",".join(f"{k}=simulated:{'ideal' if k % 2 else 'distorted'}" for k in range(LARGE + 10))},
    ],
    ids=["history", "words", "models"],
)
def test_what_does_not_scale_is_rehearsed_whole(fields: dict[str, Any]) -> None:
    assert smaller_team(team(LARGE + 10, **fields)) is None
    assert smaller_team(team(LARGE + 10)) is not None


def test_a_small_team_has_the_rules_and_the_density_of_the_large_one() -> None:
    config = team(LARGE + 10, kill="159@3", join_random=2, safe_distance=4, loss=0.2, protocol="paper", rounds=300)
    small = smaller_team(config)
    assert small is not None
    assert (small.protocol, small.links, small.model) == (config.protocol, config.links, config.model)
    assert small.mission.safe_distance == 4 and small.mission.spacing == config.mission.spacing
    (low, high), n = small.mission.arena, small.mission.n_robots
    whole = math.prod(b - a for a, b in zip(*config.mission.arena, strict=True))
    assert math.prod(b - a for a, b in zip(low, high, strict=True)) / n == pytest.approx(whole / (LARGE + 10), rel=0.3)
    assert small.trial.kill is None and small.trial.join_random == 0 and small.trial.seed == config.trial.seed


@pytest.mark.parametrize("shape", ["circle", "line", "wedge", "star", "polygon:5", "grid", "square", "cross"])
def test_every_shape_has_a_small_team(shape: str) -> None:
    for n in range(LARGE + 1, LARGE + 60):
        try:
            config = team(n, shape=shape, center=(2000, 2000), arena=((0, 0), (4000, 4000)))
        except InputError:
            continue
        assert smaller_team(config) is not None
        return
    pytest.fail("no team of this shape")
