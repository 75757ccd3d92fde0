"""Whole missions with models that are asked on events only: how often, how well, with every rule, and replayed."""

from __future__ import annotations

from pathlib import Path
from statistics import mean, median
from typing import Any

import pytest

from llm_flock import run
from llm_flock.record._reader import read_record
from llm_flock.runtime._config import build_config
from llm_flock.runtime._result import Summary

SEEDS = range(4)


def fly(seed: int = 0, **options: Any) -> Summary:
    return run(config=build_config({}, seed=seed, **{"decide": "on-event"} | options)).summary


def slowness(summary: Summary) -> float:
    return (summary.rounds_to_formed or 0) / max(1, summary.lower_bound_rounds or 0)


def test_a_third_of_the_calls_as_fast_and_as_safe() -> None:
    frugal = [fly(seed) for seed in SEEDS]
    asked = [fly(seed, decide="every-round") for seed in SEEDS]
    assert all(s.formed and s.calls_rejected == 0 for s in frugal)
    assert mean(s.model_calls / s.n_robots for s in frugal) <= 4.0
    assert mean(s.model_calls / s.n_robots for s in asked) > 10.0
    assert median(map(slowness, frugal)) <= 1.1 * median(map(slowness, asked))
    assert min(s.min_separation or 0.0 for s in frugal) >= 3.0 - 1e-6


@pytest.mark.parametrize(("protocol", "answers"), [("flock", "json"), ("paper", "text"), ("baseline", "text")])
def test_every_preset_flies_and_asks_less(protocol: str, answers: str) -> None:
    frugal = fly(3, protocol=protocol, answers=answers, rounds=15, stop_when_formed=False)
    asked = fly(3, protocol=protocol, answers=answers, rounds=15, stop_when_formed=False, decide="every-round")
    assert frugal.model_calls < asked.model_calls / 2
    assert frugal.formed == asked.formed == (protocol == "flock")


@pytest.mark.parametrize(
    "options",
    [
        {"noise": 0.3},
        {"model": "geometry"},
        {"model": "simulated:distorted@0.3,overshoot@0.3,collapse@0.2,malformed@0.2,flaky@0.1"},
        {"model": "simulated:malformed@0.5", "fallback": "geometry"},
        {"obstacles": [{"center": [50, 50], "radius": 6}], "rounds": 90},
        {"history": "full"},
    ],
    ids=lambda options: "-".join(options),
)
def test_trouble_is_met(options: dict[str, Any]) -> None:
    assert fly(5, **options).formed


def test_dead_model_does_not_end_a_run_of_robots_on_paths() -> None:
    dead = fly(1, model="0-8=simulated:ideal,9=simulated:flaky@1", max_tries=1, rounds=20)
    assert dead.stopped != "no_answers"


def test_cassette_replays_and_record_says_why_models_are_asked(tmp_path: Path) -> None:
    cassette = tmp_path / "talk.jsonl"
    first = fly(2, record_llm=str(cassette), out=str(tmp_path / "first"))
    again = fly(2, model=f"replay:{cassette}")
    same = ("rounds", "formed", "model_calls", "tokens", "min_separation", "waypoints", "procrustes_mean")
    assert [getattr(first, name) for name in same] == [getattr(again, name) for name in same]
    record = read_record(tmp_path / "first" / "run.mcap")
    reasons = [event.detail["reason"] for event in record.events if event.kind == "asked_again"]
    steps = sum(entry.kind == "step" and entry.attempt <= 1 for entry in record.llm)
    assert reasons and len(reasons) == steps - first.n_robots, "all but everybody's first question have a reason"
