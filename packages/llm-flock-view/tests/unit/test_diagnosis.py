"""Why a team did not form: by records of real runs with one fault each, and by made-up last rounds."""

from __future__ import annotations

from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import pytest
from command_line import flock
from sample_records import make_record

import llm_flock
from llm_flock import metrics
from llm_flock.record import _diagnosis as diagnosis
from llm_flock.record._diagnosis import Diagnosis, crosses, diagnose
from llm_flock.record._history import RunHistory
from llm_flock.record._reader import read_record
from llm_flock.record._schema import PlanInfo, ProtocolEvent, RunInfo, SummaryMessage
from llm_flock.record._stream import RecordStream
from llm_flock_view._figures.inline import record_html
from llm_flock_view._viewer.outcome import outcome


def replayed(path: Path) -> RunHistory:
    return RunHistory.of(RecordStream(path).entries())


def paper(folder: Path, bad: str, **fields: Any) -> RunHistory:
    """Six robots by the paper's protocol; robot 2 has another model."""
    models = f"2={bad},0-1=simulated:ideal,3-5=simulated:ideal"
    given: dict[str, Any] = {"n_robots": 6, "seed": 7, "protocol": "paper", "model": models, "rounds": 30, **fields}
    llm_flock.run(out=str(folder), **given)
    return replayed(folder / "run.mcap")


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        ("simulated:malformed", "Robot 2: its model (simulated:malformed) gave no usable answer in 90 of 90 calls."),
        (
            "simulated:collapse",
            "Robot 2: its model (simulated:collapse) led it away from its goal in 20 of its last 20 steps.",
        ),
        ("simulated:overshoot", "Robot 2: its model (simulated:overshoot) led it away from its goal in "),
    ],
)
def test_one_bad_model_is_named_under_the_papers_protocol(tmp_path: Path, bad: str, said: str) -> None:
    run = paper(tmp_path, bad)
    found = outcome(run, over=True)
    assert found["why"].startswith(said), found["why"]
    assert found["robots"] == [2] and found["interesting"] == {"robot": 2, "why": "it kept the team from forming"}


def test_plan_off_the_shape_is_its_proposers_and_its_models(tmp_path: Path) -> None:
    run = replayed(make_record(tmp_path / "run.mcap", n=4, rounds=8, agree=False))
    plan = run.plans[str(run.states[-1].plan_ids[1])]
    assert diagnose(run).robots == ()
    longer = [[3.0 * x, y] for x, y in plan.points]
    run.plans[plan.plan_id] = PlanInfo(round=1, plan_id=plan.plan_id, proposer=1, points=longer)
    found = diagnose(run)
    assert found.robots == (1,) and found.why.startswith(
        "Robot 1: its model (simulated:ideal) proposed a plan that is off the shape (distances between its places by "
    )
    assert "units on average), and robot 1 flew it." in found.why
    # Turned, shifted and in another order it is the shape all the same.
    turned = [[-y + 5.0, x - 3.0] for x, y in reversed(plan.points)]
    run.plans[plan.plan_id] = PlanInfo(round=1, plan_id=plan.plan_id, proposer=1, points=turned)
    assert diagnose(run).robots == ()


def test_two_bad_models_are_both_named(tmp_path: Path) -> None:
    models = "1=simulated:malformed,2=simulated:collapse,0=simulated:ideal,3-5=simulated:ideal"
    found = outcome(paper(tmp_path, "", model=models), over=True)
    assert set(found["robots"]) == {1, 2} and "simulated:malformed" in found["why"]
    assert "simulated:collapse" in found["why"]


def test_good_models_leave_blame_on_rules_and_something_to_see(tmp_path: Path) -> None:
    run = paper(tmp_path, "simulated:ideal", n_robots=10, model="simulated:ideal", protocol="paper-literal")
    found = outcome(run, over=True)
    assert found["why"].startswith("No robot is to blame: this protocol's rules (influence, nearest) did not bring ")
    assert found["robots"] == [] and found["interesting"]["why"] != "nothing stands out"


def test_text_of_a_time_out_ends_with_one_full_stop(tmp_path: Path) -> None:
    models = "2=simulated:flaky,0-1=simulated:ideal,3-5=simulated:ideal"
    run = paper(tmp_path, "", protocol="flock", fallback="hold", model=models, max_tries=1, rounds=6)
    found = outcome(run, over=True)
    assert found["robots"][0] == 2 and "its model (simulated:flaky) gave no usable answer in " in found["why"]
    assert ".." not in found["why"] and "The last reason: " in found["why"]


def _changed(run: RunHistory, **fields: Any) -> Diagnosis:
    run.states[-1] = run.states[-1].model_copy(update=fields)
    return diagnose(run)


def test_robot_out_of_range_is_named_and_since_when(tmp_path: Path) -> None:
    run = replayed(make_record(tmp_path / "run.mcap", n=5, rounds=5))
    plan = run.states[-1].plan_ids[0]
    near = [[50.0 + 8.0 * k, 50.0] for k in range(4)]
    found = _changed(run, positions=[*near, [95.0, 5.0]], goals=[*near, [58.0, 50.0]], plan_ids=[plan] * 5)
    assert found.robots == (4,)
    assert found.why == ("Robot 4 was out of radio range of the others at the end; never were all robots in contact.")
    run.rows[2] = run.rows[2].model_copy(update={"connected": True})
    assert "all were in contact up to round 2" in diagnose(run).why
    found = _changed(run, positions=[[20.0 * k, 5.0] for k in range(5)])
    assert "At the end no robot was in radio range of another one." in found.why and found.robots == ()
    found = _changed(run, positions=[[5.0, 5.0], [9.0, 5.0], [50.0, 5.0], [55.0, 5.0], [95.0, 5.0]])
    assert "3 parts out of radio range of one another: robots 0, 1; robots 2, 3; robot 4." in found.why


def test_with_weak_rules_only_the_never_met_are_out_of_range(tmp_path: Path) -> None:
    run = replayed(make_record(tmp_path / "run.mcap", n=5, rounds=3))
    assert run.info is not None
    rules = {"consensus": "influence", "assignment": "nearest"}
    run.info = run.info.model_copy(update={"config": {**run.info.config, "protocol": rules}})
    near = [[50.0 + 8.0 * k, 50.0] for k in range(4)]
    for k, state in enumerate(run.states):
        run.states[k] = state.model_copy(update={"positions": [*near, [95.0, 5.0]]})
    assert "Robot 4 was out of radio range of all others in every round." in diagnose(run).why
    run.states[1] = run.states[1].model_copy(update={"positions": [*near, [60.0, 45.0]]})
    assert "radio" not in diagnose(run).why


def test_lost_messages_and_too_few_rounds_are_explained(tmp_path: Path) -> None:
    run = replayed(make_record(tmp_path / "run.mcap", n=4, rounds=5))
    assert run.info is not None and run.loss == 0.0
    fields = run.info.model_dump()
    run.info = RunInfo(**{**fields, "config": {**fields["config"], "links": {"loss": 0.9}}})
    assert "90 % of the messages were lost." in diagnose(run).why
    lost = {"model": None, "loss": 0.1}
    run.write(ProtocolEvent(round=4, comm_round=None, robot=0, kind="injected", detail=lost))
    assert run.loss == 0.1 and "lost" not in diagnose(run).why
    run.write(SummaryMessage(result={"formed": False, "stopped": "rounds"}))
    at = run.states[-3].positions[0]
    for back in (2, 1, 0):
        state = run.states[-1 - back]
        rows = [[at[0] + 30.0 - 6.0 * (2 - back) - 30.0, at[1]], *state.positions[1:]]
        run.states[-1 - back] = state.model_copy(update={"positions": rows})
    found = _changed(run, goals=[[at[0] - 40.0, at[1]], *run.states[-1].goals[1:]])
    assert "Robot 0 was still on its way, 28 units from its place, when the rounds were used up." in found.why
    run.write(SummaryMessage(result={"formed": False, "stopped": "budget"}))
    assert "The budget was used up in round 5." in diagnose(run).why


def test_obstacle_in_the_way_is_explained(tmp_path: Path) -> None:
    run = replayed(make_record(tmp_path / "run.mcap", n=4, rounds=5))
    mission = run.missions[0].mission
    run.missions[0] = run.missions[0].model_copy(update={"mission": {**mission, "comm_range": 1000.0}})
    goal = run.states[-1].goals[1]
    assert goal is not None
    rows = [list(row) for row in run.states[-1].positions]
    rows[1] = [goal[0] + 20.0, goal[1]]
    assert _changed(run, positions=rows).why == "Robot 1 had not reached its place."
    waits = ProtocolEvent(round=5, comm_round=None, robot=1, kind="deadlock", detail={"rounds": 9})
    run.write(waits)
    assert diagnose(run).why == "Robot 1 had not reached its place: other robots were in its way."
    ball = {"center": [goal[0] + 10.0, goal[1] + 1.0], "radius": 2.0}
    run.missions[0] = run.missions[0].model_copy(
        update={"mission": {**mission, "comm_range": 1000.0, "obstacles": [ball]}}
    )
    found = diagnose(run)
    assert found.robots == (1,) and found.why == "Robot 1 had not reached its place: an obstacle stood in its way."


def test_ways_cross_discs_balls_and_polygons() -> None:
    wall = {"polygon": [[4.0, -5.0], [5.0, -5.0], [5.0, 5.0], [4.0, 5.0]]}
    assert crosses(([0.0, 0.0], [10.0, 0.0]), wall) and not crosses(([0.0, 6.0], [10.0, 6.0]), wall)
    disc = {"center": [5.0, 1.0], "radius": 2.0}
    assert crosses(([0.0, 0.0], [10.0, 0.0]), disc) and not crosses(([0.0, 0.0], [2.0, 0.0]), disc)
    ball = {"center": [5.0, 0.0, 9.0], "radius": 2.0}
    assert not crosses(([0.0, 0.0, 0.0], [10.0, 0.0, 0.0]), ball)
    assert crosses(([0.0, 0.0, 8.0], [10.0, 0.0, 8.0]), ball)


def test_run_with_its_last_round_in_order_is_diagnosed(tmp_path: Path) -> None:
    run = replayed(make_record(tmp_path / "run.mcap", n=4, rounds=5))
    mission = run.missions[0].mission
    run.missions[0] = run.missions[0].model_copy(update={"mission": {**mission, "comm_range": 1000.0}})
    state = run.states[-1]
    plan = state.plan_ids[0]
    goals = [list(row) for row in run.plans[str(plan)].points]
    found = _changed(run, plan_ids=[plan] * 4, goals=goals, positions=goals)
    assert found.why == "By the record, nothing was wrong in the last round." and found.robots == ()


def test_pages_notebooks_and_the_command_line_say_the_same(tmp_path: Path) -> None:
    path = make_record(tmp_path / "run.mcap", n=5, rounds=4, agree=False)
    record, history = read_record(path), replayed(path)
    found = diagnose(history)
    assert record.diagnosis() == found and outcome(history, over=True)["why"] == found.why
    shown = " ".join(flock("inspect", "run.mcap", cwd=tmp_path).stdout.split())
    assert found.why in shown and escape(found.why) in record_html(record)
    assert replace(record, result={"formed": True}).diagnosis() == Diagnosis()


def test_a_cause_has_the_round_and_the_call_behind_it(tmp_path: Path) -> None:
    run = paper(tmp_path, "simulated:malformed")
    cause = diagnose(run).causes[0]
    assert cause.robots == (2,) and cause.round == run.last_round
    assert {(entry.robot, entry.round) for entry in cause.calls} == {(2, run.last_round)}
    assert all(entry.rejected for entry in cause.calls)


def test_a_record_without_a_step_limit_is_diagnosed(tmp_path: Path) -> None:
    run = replayed(make_record(tmp_path / "run.mcap", n=4, rounds=5, agree=False))
    fields = {name: value for name, value in run.missions[0].mission.items() if name != "max_step"}
    run.missions[0] = run.missions[0].model_copy(update={"mission": fields})
    run.write(SummaryMessage(result={"formed": False, "stopped": "rounds"}))
    assert "4 plans were in use at the end" in diagnose(run).why


def test_places_and_shapes_are_judged_as_by_the_metrics() -> None:
    assert (diagnosis.AT_GOAL, diagnosis.IN_SHAPE) == (metrics.AT_GOAL, metrics.IN_SHAPE)
