"""The whole protocol over real HTTP, against a server that is late, turns away, breaks, cuts and babbles."""

import time
from functools import partial
from itertools import pairwise
from pathlib import Path

import pytest
from integration.fault_server import answering, completion, running
from slowness import slowness

import llm_flock
from llm_flock.llm._limits import RetryPolicy
from llm_flock.runtime import _planners as planners

MODEL = "openai-compatible:test"


def test_circle_of_ten_against_a_faulty_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The run ends with a readable record, and every fault that the server sent is counted, kind by kind."""
    monkeypatch.setattr(planners, "RetryPolicy", partial(RetryPolicy, first_wait_s=0.01))
    with running(
        late=0.01, late_latency=3, rate_limit=0.05, server_error=0.05, cut=0.05, garbage=0.08, seed=3
    ) as server:
        result = llm_flock.run(
            llm_flock.Mission(shape="circle", n_robots=10),
            model=MODEL,
            base_url=server.base_url,
            seed=7,
            rounds=14,
            timeout_s=1.5,
            out=str(tmp_path),
        )
        sent = server.stats()
    figures = result.summary
    record = llm_flock.read_record(tmp_path / "run.mcap")
    assert record.complete and len(record.states) == figures.rounds + 1
    assert sent["late"] and sent["rate_limit"] and sent["server_error"] and sent["cut"] and sent["garbage"]
    assert figures.faults["timeout"] == sent["late"]
    assert figures.faults["rate_limit"] == sent["rate_limit"]
    # Bodies that are no chat completion are faults; a chat completion with a useless text is a rejected answer.
    bodies = sent["garbage"] - sent["unusable"]
    assert figures.faults["server"] + figures.faults["connection"] + figures.faults.get("garbage", 0) == (
        sent["server_error"] + sent["cut"] + bodies
    )
    # What can be read and still comes too near another robot is sent back by the verification.
    reasons = [entry.rejected for entry in record.llm if entry.rejected is not None]
    assert figures.calls_rejected == len(reasons)
    assert sum(not reason.startswith("the position is") for reason in reasons) == sent["unusable"]
    assert sum(len(entry.faults) for entry in record.llm) == sum(figures.faults.values())
    assert figures.plans_in_use == 1 and figures.distinct_goals == 10
    assert figures.min_separation is not None and figures.min_separation >= 3 - 1e-6


def test_a_server_that_is_down_makes_every_robot_hold(tmp_path: Path) -> None:
    result = llm_flock.run(
        llm_flock.Mission(shape="triangle", n_robots=3),
        model=MODEL,
        base_url="http://127.0.0.1:9/v1",
        rounds=1,
        max_tries=2,
        fallback="hold",
        out=str(tmp_path),
    )
    figures = result.summary
    assert figures.robots_without_plan == 3 and figures.waypoint_shares["hold"] == 1.0
    assert figures.faults == {"connection": 6} and figures.calls_failed == 3
    record = llm_flock.read_record(tmp_path / "run.mcap")
    assert all(entry.error is not None and entry.error.startswith("connection") for entry in record.llm)


def test_fifty_robots_do_not_wait_for_each_other() -> None:
    """A server that takes 0.3 s: a round of fifty takes little more, because all ask at once."""
    side = 200.0
    mission = llm_flock.Mission(shape="circle", n_robots=50, center=(side / 2, side / 2), arena=((0, 0), (side, side)))
    times = [time.perf_counter()]
    with running(latency=0.3) as server:
        llm_flock.run(
            mission,
            model=MODEL,
            base_url=server.base_url,
            rounds=4,
            stop_when_formed=False,
            on_round=lambda _: times.append(time.perf_counter()),
        )
    rounds = [b - a for a, b in pairwise(times[1:])]
    assert min(rounds) >= 0.3
    assert sorted(rounds)[1] < 0.3 + 0.5 * slowness()


def test_a_cap_on_answers_reaches_the_server_and_the_record(tmp_path: Path) -> None:
    """Every answer is cut off: all can be read, and none is flown."""
    body = completion(b"", "Plan: [[45, 45], [55, 45], [50, 54]]\nmy plan: 0", "length")
    with answering(body) as (base_url, seen):
        result = llm_flock.run(
            llm_flock.Mission(shape="triangle", n_robots=3),
            model=MODEL,
            base_url=base_url,
            rounds=1,
            max_retries=0,
            max_answer_tokens=40,
            out=str(tmp_path),
        )
    assert {request["max_tokens"] for request in seen} == {40}
    record = llm_flock.read_record(tmp_path / "run.mcap")
    assert record.run.config["limits"]["max_answer_tokens"] == 40
    assert len(record.llm) == result.summary.calls_rejected == len(seen) > 0
    for entry in record.llm:
        assert entry.finish_reason == "length" and entry.settings == {"max_tokens": 40} and entry.parsed is None
        assert entry.rejected is not None and "cut off at" in entry.rejected
    assert result.summary.plans_in_use == 0


BAD = "openai-compatible:bad"


@pytest.mark.parametrize(("shape", "robots", "one_in"), [("circle", 10, 2), ("square", 8, 5)])
def test_robots_with_a_bad_model_harm_no_other(shape: str, robots: int, one_in: int) -> None:
    """Every fifth or second robot's model always distorts its plan and always overshoots, over real HTTP.

    `python -m benchmarks containment-http` flies twenty of each.
    """
    models = ",".join(f"{robot}={BAD if robot % one_in == 0 else MODEL}" for robot in range(robots))
    with running(bad_profile="distorted,overshoot") as server:
        figures = llm_flock.run(
            llm_flock.Mission(shape=shape, n_robots=robots), model=models, base_url=server.base_url, seed=1
        ).summary
    assert figures.formed and figures.plan_by is not None and "test" in figures.plan_by
    assert figures.min_separation is not None and figures.min_separation >= 3 - 1e-6
    assert figures.calls_rejected <= 6 * len(range(0, robots, one_in))


@pytest.mark.parametrize("body", ["nested", "surrogate"])
def test_a_hostile_body_ends_no_run_and_no_record(tmp_path: Path, body: str) -> None:
    """Lists in lists that no parser gets to the end of, and half of a character in the name of the model."""
    nested = b'{"choices":' + b"[" * 100_000 + b"]" * 100_000 + b"}"
    named = completion(b"", "Plan: none").replace(b'"stand-in"', b'"half \\ud800 name"')
    with answering(nested if body == "nested" else named) as (url, _):
        figures = llm_flock.run(
            llm_flock.Mission(shape="triangle", n_robots=3),
            model=f"0={MODEL},1-2=simulated:ideal",
            base_url=url,
            max_tries=1,
            seed=1,
            out=str(tmp_path),
        ).summary
    assert figures.formed and figures.breakers_opened == (0,) and llm_flock.read_record(tmp_path / "run.mcap").complete
