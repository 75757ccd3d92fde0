"""Whole runs in one process: what the presets do, what is recorded, what is reproducible, what goes wrong well."""

import asyncio
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import llm_flock
from llm_flock.errors import InputError, ReplayDrift
from llm_flock.llm._limits import Limited
from llm_flock.llm._port import Call, Reply
from llm_flock.llm._simulated.model import SimulatedModel
from llm_flock.llm._simulated.profiles import parse_profile
from llm_flock.metrics import segment_separation
from llm_flock.protocol._breaker import Fallback
from llm_flock.record._reader import iter_messages
from llm_flock.record._schema import CHANNELS, channel_schema
from llm_flock.runtime import _journal as journal

VOLATILE: dict[str, Any] = {"wall_s": 0.0, "latency_mean_s": 0.0}

CASES = [("triangle", 3), ("triangle", 6), ("square", 4), ("square", 8), ("cross", 5), ("circle", 5), ("circle", 10)]


@pytest.mark.parametrize(("shape", "n"), CASES)
def test_the_papers_cases_form_and_stay_safe(shape: str, n: int) -> None:
    result = llm_flock.run(llm_flock.Mission(shape=shape, n_robots=n), seed=11)
    figures = result.summary
    assert figures.formed and figures.stopped == "formed" and figures.simulated
    assert figures.plans_in_use == 1 and figures.distinct_goals == n
    assert figures.min_separation is not None and figures.min_separation >= 3 - 1e-6
    assert figures.rounds_to_formed is not None and figures.lower_bound_rounds is not None
    assert figures.rounds_to_formed >= figures.lower_bound_rounds
    assert result.positions.shape == (figures.rounds + 1, n, 2)
    assert result.errors[-1] == figures.procrustes_mean


def test_a_large_team_is_measured_when_all_are_at_their_goals(monkeypatch: pytest.MonkeyPatch) -> None:
    mission = llm_flock.Mission(shape="circle", n_robots=10)
    every = llm_flock.run(mission, seed=3)
    monkeypatch.setattr(journal, "ERROR_EVERY_ROUND_UP_TO", 9)
    late = llm_flock.run(mission, seed=3)
    first = late.summary.rounds_to_formed
    assert first is not None and first == every.summary.rounds_to_formed and late.formed
    assert np.isnan(late.errors[:first]).all()
    assert late.errors[first:].tolist() == every.errors[first:].tolist()
    early = llm_flock.run(mission, seed=3, rounds=2)
    assert early.summary.procrustes_mean == every.errors[2], "the end is always measured"
    assert np.isnan(early.errors[:2]).all()


@pytest.mark.parametrize("extra", [{"answers": "json"}, {"history": "last:2"}, {"observe": "all"}, {"noise": 0.1}])
def test_conversation_options_do_not_prevent_forming(extra: dict[str, Any]) -> None:
    result = llm_flock.run(llm_flock.Mission(shape="square", n_robots=4), seed=2, **extra)
    assert result.formed
    assert result.summary.min_separation is not None and result.summary.min_separation >= 3 - 1e-6


def test_literal_paper_and_baseline_do_not_form_the_circle() -> None:
    mission = llm_flock.Mission(shape="circle", n_robots=10)
    for protocol in ("paper-literal", "baseline"):
        figures = llm_flock.run(mission, protocol=protocol, seed=7, rounds=40).summary
        assert not figures.formed
        assert figures.plans_in_use > 1 or figures.distinct_goals < 10


def test_without_the_shield_a_model_is_obeyed_to_the_letter() -> None:
    mission = llm_flock.Mission(shape="circle", n_robots=10)
    figures = llm_flock.run(mission, protocol="paper", seed=7, rounds=15).summary
    assert figures.waypoint_shares["model"] == 1.0


def test_plain_geometry_needs_no_model() -> None:
    figures = llm_flock.run(llm_flock.Mission(shape="circle", n_robots=5), model="geometry", seed=1).summary
    assert figures.formed and figures.model_calls == 0 and not figures.simulated


def test_a_single_robot_is_a_team() -> None:
    result = llm_flock.run(llm_flock.Mission(shape="line", n_robots=1), seed=1)
    assert result.formed and result.summary.min_separation is None


def test_three_dimensions() -> None:
    corners = ((0, 0, 0), (10, 0, 0), (0, 10, 0), (0, 0, 10))
    mission = llm_flock.build_mission(points=corners, center=(50, 50, 50), arena=((0, 0, 0), (100, 100, 100)))
    figures = llm_flock.run(mission, model="geometry", seed=3).summary
    assert figures.distinct_goals == 4
    assert figures.min_separation is not None and figures.min_separation >= 3 - 1e-6


class RingModel:
    """A *simulated* model that gives a plan which it was told, and flies straight."""

    __module__ = "rings"
    simulated = True

    def __init__(self, ring: list[list[float]]) -> None:
        self._ring, self._good = ring, SimulatedModel(parse_profile("ideal"), np.random.default_rng(0))

    async def ask(self, call: Call) -> str | Reply:
        if call.kind == "step":
            return await self._good.ask(call)
        return f"Plan: {self._ring}\nmy plan: {call.robot}"


def test_free_text_has_no_ideal_to_compare_with() -> None:
    ring = [[50.0 + 10.0 * math.cos(k * math.pi / 3), 50.0 + 10.0 * math.sin(k * math.pi / 3)] for k in range(6)]
    model = RingModel(ring)
    result = llm_flock.run(llm_flock.Mission(shape="text:a ring", n_robots=6), model=model, seed=1)
    assert result.formed and result.summary.procrustes_mean is None
    assert np.isnan(result.errors).all()


def messages(path: Path) -> list[tuple[str, str]]:
    """Everything in a record but what may differ between two runs of one seed."""
    found: list[tuple[str, str]] = []
    for message in iter_messages(path):
        fields = message.decoded()
        entry = CHANNELS.get(message.topic)
        declared: dict[str, Any] = {} if entry is None else channel_schema(entry)["properties"]
        if message.topic == "/summary":
            for name in ("wall_s", "latency_mean_s", "record", "flight"):
                fields["result"].pop(name, None)
        kept = {name: value for name, value in fields.items() if "volatile" not in declared.get(name, {})}
        found.append((message.topic, json.dumps(kept, sort_keys=True)))
    return found


def test_the_same_seed_gives_the_same_record(tmp_path: Path) -> None:
    mission = llm_flock.Mission(shape="triangle", n_robots=6)
    options: dict[str, Any] = {"loss": 0.3, "delay": 1, "duplicate": 0.1, "reorder": 0.5, "noise": 0.05}
    options |= {"model": "simulated:distorted@0.3,overshoot@0.3,malformed@0.2"}
    for name, seed in (("a", 5), ("b", 5), ("c", 6)):
        llm_flock.run(mission, out=str(tmp_path / name), rounds=12, seed=seed, **options)
    a, b = messages(tmp_path / "a/run.mcap"), messages(tmp_path / "b/run.mcap")
    assert a == b and len(a) > 100
    assert messages(tmp_path / "c/run.mcap") != a


def test_a_record_holds_the_norm_by_which_it_was_judged(tmp_path: Path) -> None:
    mission = llm_flock.Mission(shape="sphere", n_robots=6, downwash=2.0, sense_range=18.0)
    flown = llm_flock.run(mission, model="geometry", seed=1, rounds=8, out=str(tmp_path))
    record = llm_flock.read_record(tmp_path / "run.mcap")
    assert record.mission.mission["downwash"] == 2.0 and llm_flock.Mission(**record.mission.mission) == mission
    ways = zip(record.positions, record.positions[1:], strict=False)
    seen = min(segment_separation(*way, downwash=2.0) for way in ways)
    assert flown.summary.min_separation == pytest.approx(seen)


def test_the_protocol_does_not_change_starts_or_proposals(tmp_path: Path) -> None:
    """Two protocols on one seed can be compared, because only the rules differ."""
    mission = llm_flock.Mission(shape="square", n_robots=4)
    a = llm_flock.run(mission, protocol="flock", seed=9, out=str(tmp_path / "a"), rounds=3)
    b = llm_flock.run(mission, protocol="baseline", seed=9, out=str(tmp_path / "b"), rounds=3)
    assert (a.positions[0] == b.positions[0]).all()
    plans = [[p.points for p in llm_flock.read_record(tmp_path / x / "run.mcap").plans] for x in "ab"]
    assert plans[0] == plans[1]


def test_a_recorded_conversation_replays_call_for_call(tmp_path: Path) -> None:
    mission = llm_flock.Mission(shape="triangle", n_robots=6)
    tape = tmp_path / "tape.jsonl"
    options: dict[str, Any] = {"seed": 4, "rounds": 12}
    model = "simulated:malformed@0.3,overshoot@0.3"
    first = llm_flock.run(mission, model=model, record_llm=str(tape), **options)
    again = llm_flock.run(mission, model=f"replay:{tape}", **options)
    assert again.summary.simulated
    assert (first.positions == again.positions).all()
    for key in ("model_calls", "calls_rejected", "tokens", "faults", "formed"):
        assert getattr(first.summary, key) == getattr(again.summary, key)
    with pytest.raises(ReplayDrift, match="robot"):
        llm_flock.run(mission, model=f"replay:{tape}", seed=5, rounds=12, out=str(tmp_path / "drift"))
    record = llm_flock.read_record(tmp_path / "drift/run.mcap")
    assert not record.complete
    assert record.result is not None and record.result["stopped"] == "failed"
    assert "ReplayDrift" in record.result["reason"]


def test_a_replay_recorded_again_is_the_same_cassette(tmp_path: Path) -> None:
    mission = llm_flock.Mission(shape="triangle", n_robots=3)
    first, second = tmp_path / "a.jsonl", tmp_path / "b.jsonl"
    llm_flock.run(mission, model="simulated:flaky@0.4", max_tries=1, record_llm=str(first), rounds=5)
    llm_flock.run(mission, model=f"replay:{first}", max_tries=1, record_llm=str(second), rounds=5)
    lines = [sorted(json.dumps(_still(line)) for line in path.read_text().splitlines()) for path in (first, second)]
    assert lines[0] == lines[1]


def _still(line: str) -> dict[str, Any]:
    """A cassette line without how long it took."""
    return {key: value for key, value in json.loads(line).items() if key != "latency_s"}


def test_run_ends_and_says_why_once_no_model_answers() -> None:
    mission = llm_flock.Mission(shape="triangle", n_robots=3)
    fallbacks: tuple[tuple[Fallback, int], ...] = (("breaker", 2), ("hold", 3))
    for fallback, rounds in fallbacks:
        figures = llm_flock.run(mission, model="simulated:flaky", max_tries=1, fallback=fallback).summary
        assert (figures.stopped, figures.rounds) == ("no_answers", rounds)
        assert figures.reason and "simulated" in figures.reason


def test_run_without_any_plan_ends_and_says_what_was_wrong() -> None:
    figures = llm_flock.run(llm_flock.Mission(n_robots=10), model="simulated:distorted", seed=2).summary
    assert figures.stopped == "no_plan" and figures.rounds <= 10 and figures.model_calls <= 6 * 10
    assert figures.reason and re.match(r"\d+ of 10 robots: no usable answer in 3 tries; the last: ", figures.reason)
    assert figures.plan_by is None and not figures.formed and figures.breakers_opened == tuple(range(10))


def test_a_run_whose_model_may_still_be_heard_of_goes_on() -> None:
    """A robot with a good model joins when all others are no longer asked."""
    mission = llm_flock.Mission(shape="triangle", n_robots=3)
    figures = llm_flock.run(mission, model="0-1=simulated:distorted,2=simulated:ideal", seed=2, join="2@8").summary
    assert figures.formed and (figures.plan_robot, figures.plan_by) == (2, "simulated:ideal")


def test_summary_says_how_much_the_models_did() -> None:
    mission = llm_flock.Mission(shape="square", n_robots=4)
    good = llm_flock.run(mission, seed=3).summary
    assert good.formed and good.formed_by_models and not good.breakers_opened and good.plan_by == "simulated:ideal"
    assert sum(good.waypoint_shares.values()) == pytest.approx(1.0)
    helped = llm_flock.run(mission, seed=3, model="0-2=simulated:ideal,3=simulated:collapse").summary
    assert helped.formed and not helped.formed_by_models and 3 in helped.breakers_opened
    planned = llm_flock.run(mission, seed=3, model="simulated:distorted", fallback="geometry").summary
    assert planned.formed and not planned.formed_by_models and planned.plan_by == "geometry"
    plain = llm_flock.run(mission, seed=3, model="geometry").summary
    assert plain.formed and plain.plan_by == "geometry" and not plain.formed_by_models


def test_default_rounds_follow_from_the_lower_bound() -> None:
    wide = {"shape": "line", "n_robots": 2, "center": (500, 500), "arena": ((0, 0), (1000, 1000))}
    far = ((1.0, 1.0), (9.0, 1.0))
    figures = llm_flock.run(llm_flock.Mission(**wide), start_positions=far).summary
    assert figures.formed and figures.rounds > 100
    lost = llm_flock.run(llm_flock.Mission(**wide), start_positions=far, max_calls=20).summary
    assert lost.stopped == "budget"
    stuck = llm_flock.run(llm_flock.Mission(n_robots=3), model="simulated:collapse", fallback="hold", seed=1).summary
    assert not stuck.formed and stuck.stopped == "rounds" and stuck.rounds > 22


def test_run_that_stops_formed_counts_as_formed() -> None:
    """A team that forms later than the deadline, in a run that was given more rounds."""
    figures = llm_flock.run(llm_flock.Mission(shape="wedge", n_robots=13), seed=7, rounds=200).summary
    assert (figures.stopped == "formed") == figures.formed


def test_formation_out_of_radio_contact_is_warned_and_bounded(caplog: pytest.LogCaptureFixture) -> None:
    mission = llm_flock.Mission(n_robots=10, comm_range=5, sense_range=15)
    figures = llm_flock.run(mission, seed=0, rounds=60).summary
    assert figures.lower_bound_rounds and figures.plans_in_use == 1
    assert "comm_range = 5 is too short" in caplog.text


def test_influence_counts_radio_neighbours_not_sensed_ones() -> None:
    """With short sensors and a long radio the paper's rule still hears everybody."""
    places = ((40.0, 40.0), (60.0, 40.0), (50.0, 60.0), (50.0, 20.0), (90.0, 90.0))
    seen = [
        llm_flock.run(
            llm_flock.Mission(shape="circle", n_robots=5, comm_range=30, sense_range=sense),
            protocol="paper",
            start_positions=places,
            seed=1,
            rounds=4,
        )
        for sense in (1.0, 30.0)
    ]
    assert seen[0].plans == seen[1].plans
    assert seen[0].summary.plans_in_use < 5


def test_faulty_models_hold_their_robot_and_never_the_others(tmp_path: Path) -> None:
    mission = llm_flock.Mission(shape="square", n_robots=4)
    model = "0-2=simulated:ideal,3=simulated:malformed"
    result = llm_flock.run(mission, model=model, seed=3, out=str(tmp_path), rounds=25, fallback="hold")
    record = llm_flock.read_record(tmp_path / "run.mcap")
    assert result.summary.waypoints["hold"] == 25
    assert {e.robot for e in record.events if e.kind in ("held", "no_plan")} == {3}
    assert np.linalg.norm(result.positions[-1][:3] - result.positions[0][:3], axis=1).min() > 0
    assert (result.positions[-1][3] == result.positions[0][3]).all()


def test_overshooting_models_keep_the_limit_and_are_clipped() -> None:
    mission = llm_flock.Mission(shape="triangle", n_robots=3)
    results = [llm_flock.run(mission, model="simulated:overshoot", seed=3, verify=verify) for verify in (False, True)]
    for result in results:
        steps = np.linalg.norm(np.diff(result.positions, axis=0), axis=2)
        assert steps.max() <= 6 + 1e-6
    assert [result.formed for result in results] == [False, True]
    assert results[1].summary.waypoints["clipped"] > 0 and results[1].summary.calls_rejected == 0
    assert results[1].summary.formed_by_models, "clipping is no help from outside"
    asked_again = llm_flock.run(mission, model="simulated:overshoot", seed=3, fallback="hold").summary
    assert asked_again.formed and asked_again.calls_rejected > 0


def test_every_robot_thinks_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """All calls of a round are under way together, up to the limit."""
    now = most = 0

    async def slowly(self: Limited, call: Call) -> Reply:
        nonlocal now, most
        now += 1
        most = max(most, now)
        await asyncio.sleep(0.01)
        now -= 1
        return await original(self, call)

    original = Limited.ask
    monkeypatch.setattr(Limited, "ask", slowly)
    llm_flock.run(llm_flock.Mission(n_robots=10), seed=1, rounds=2)
    assert most == 10


def test_config_and_options_are_not_mixed() -> None:
    from llm_flock.runtime._config import build_config

    with pytest.raises(InputError, match="config"):
        llm_flock.run(llm_flock.Mission(), config=build_config())


FAULTY = "simulated:distorted@0.3,overshoot@0.3,malformed@0.1"


@pytest.mark.parametrize(("shape", "n"), [("triangle", 6), ("square", 8)])
def test_faulty_models_together_still_form_within_the_retries(tmp_path: Path, shape: str, n: int) -> None:
    result = llm_flock.run(llm_flock.Mission(shape=shape, n_robots=n), model=FAULTY, seed=1, out=str(tmp_path))
    assert result.formed and result.summary.min_separation is not None and result.summary.min_separation >= 3 - 1e-6
    record = llm_flock.read_record(tmp_path / "run.mcap")
    reasons = [entry.rejected for entry in record.llm if entry.rejected]
    assert any("nearest to point" in reason or "apart" in reason for reason in reasons)
    assert any("beyond your goal" in entry.clipped for entry in record.llm if entry.clipped)
    assert max(entry.attempt for entry in record.llm) <= 5
    assert not any(event.kind == "rejected_message" for event in record.events), "no bad plan was ever sent"
    assert not any("beyond your goal" in reason for reason in reasons), "that is clipped and flown"


def test_hallucinated_plans_win_only_without_verification() -> None:
    mission = llm_flock.Mission(shape="triangle", n_robots=6)
    model = "0-4=simulated:ideal,5=simulated:distorted"
    assert not any(llm_flock.run(mission, model=model, seed=s, verify=False, shield=True).formed for s in (1, 2))
    for seed in (1, 2):
        result = llm_flock.run(mission, model=model, seed=seed)
        assert result.formed and result.plans[5] == result.plans[0]


def test_plain_geometry_stands_in_only_where_allowed(tmp_path: Path) -> None:
    mission = llm_flock.Mission(shape="triangle", n_robots=3)
    held = llm_flock.run(mission, model="simulated:malformed", seed=1, rounds=5, fallback="hold")
    assert held.summary.waypoint_shares["hold"] == 1.0 and held.summary.robots_without_plan == 3
    flown = llm_flock.run(mission, model="simulated:malformed", seed=1, fallback="geometry", out=str(tmp_path))
    assert flown.formed and flown.summary.waypoint_shares["geometry"] == 1.0
    record = llm_flock.read_record(tmp_path / "run.mcap")
    notes = [event.detail for event in record.events if event.kind == "fallback"]
    assert {(note["question"], note["by"]) for note in notes} == {("plan", "geometry"), ("step", "geometry")}


def test_a_fallback_needs_verification() -> None:
    with pytest.raises(InputError, match="fallback"):
        llm_flock.run(llm_flock.Mission(), protocol="paper", fallback="geometry")


def test_team_flies_the_last_of_several_orders_in_a_round() -> None:
    """Given to robots at the two ends of a line that are no neighbours."""
    line = llm_flock.Mission(shape="line", n_robots=4)
    orders = [
        {"round": 8, "robot": 3, "set": {"spacing": 12}},
        {"round": 8, "robot": 0, "set": {"shape": "square", "spacing": 10}},
    ]
    figures = llm_flock.run(line, seed=2, changes=orders)
    assert figures.formed and [m.shape for m in figures.summary.missions] == ["line", "line", "square"]
    assert figures.summary.missions[-1].formed is not None and figures.summary.missions[1].formed is None


def test_a_body_flies_no_farther_than_its_limit() -> None:
    run = llm_flock.run(shape="triangle", n_robots=3, protocol="baseline", model="simulated:overlong", rounds=6, seed=1)
    flown = np.linalg.norm(np.diff(run.positions, axis=0), axis=2)
    assert flown.max() <= run.mission.max_step * (1 + 1e-9)
    assert run.summary.steps_over_limit > 0
