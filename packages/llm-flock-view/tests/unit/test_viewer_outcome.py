"""What the first screen says of a run: formed or not, when, which mission, and who kept the team from it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from sample_records import FakeRun, llm_entry, make_record

import llm_flock
from llm_flock.record._outcome import mission_parts
from llm_flock.record._schema import MissionInfo, ProtocolEvent, RoundEnd, State, SummaryMessage
from llm_flock.record._words import formed_in
from llm_flock_view._viewer.data import frames, news
from llm_flock_view._viewer.library import Library, load
from llm_flock_view._viewer.outcome import outcome
from llm_flock_view._viewer.recording import Recording, close_pairs
from llm_flock_view._viewer.run_rows import run_row


def replayed(path: Path) -> Recording:
    run = Library().add("test", path, live=False)
    load(run)
    return run


def told(run: Recording) -> dict[str, Any]:
    return outcome(run.history, over=not run.open)


def flown(folder: Path, **fields: Any) -> Recording:
    given: dict[str, Any] = {"shape": "circle", "n_robots": 6, "seed": 2, **fields}
    llm_flock.run(out=str(folder), **given)
    return replayed(folder / "run.mcap")


def test_one_hopeless_model_is_named_and_shown_first(tmp_path: Path) -> None:
    models = "3=simulated:malformed,0-2=simulated:ideal,4-5=simulated:ideal"
    run = flown(tmp_path, model=models, fallback="hold", rounds=15)
    found = told(run)
    assert (found["tone"], found["headline"]) == ("bad", "Not formed: all 15 rounds were used up")
    assert found["robots"] == [3] and found["protocol"] == "flock"
    said = "Robot 3: its model (simulated:malformed) gave no usable answer in 45 of 45 calls. The last reason: "
    assert found["why"].startswith(said) and not found["why"].endswith("..")
    assert found["interesting"] == {"robot": 3, "why": "it kept the team from forming"}
    row = run_row(run)
    assert row["why"] == "Robot 3: its model (simulated:malformed) gave no usable answer in 45 of 45 calls."
    assert row["tone"] == "bad" and row["ratio"] is None and len(row["thumbnail"]) == 6 and row["deletable"]


def test_a_run_that_formed_says_when_and_by_whom(tmp_path: Path) -> None:
    run = flown(tmp_path, model="simulated:ideal")
    found = told(run)
    assert run.history.result is not None
    when = run.history.result["rounds_to_formed"]
    assert (found["tone"], found["headline"], found["why"]) == ("good", f"Formed in round {when}", "")
    stood = f"Stood from round {when} to the end in round {run.history.last_round}"
    assert found["by"].startswith(f"{stood} · plan by robot {run.history.result['plan_robot']} (simulated:ideal)")
    assert found["stood"] == [(when, run.history.last_round)]
    assert run_row(run)["ratio"] == round(when / run.history.result["lower_bound_rounds"], 3)


def test_each_mission_of_a_run_has_its_own_rounds(tmp_path: Path) -> None:
    changes = [{"round": 14, "robot": 0, "set": {"shape": "line"}}]
    run = flown(tmp_path, model="simulated:ideal", n_robots=8, seed=3, changes=changes)
    first, second = mission_parts(run.history)
    assert run.history.result is not None
    given = run.history.result["missions"]
    assert (first.first, first.last, first.text, first.formed) == (0, 13, "circle of 8", given[0]["formed"])
    assert (second.first, second.last, second.text) == (14, None, "line of 8")
    assert second.formed == given[1]["formed"] == 13 + run.history.result["rounds_to_formed"]
    took = run.history.result["rounds_to_formed"]
    assert told(run)["headline"] == f"Mission 2 of 2 (line of 8) formed in round {13 + took} (given in round 14)"
    # Figures, notebooks and tables count as this page does.
    assert formed_in(run.history.result) == 13 + took == second.formed
    assert formed_in({"formed": True}) is None and formed_in({"missions": [{"formed": 3}]}) is None
    # While it flies there is no result: what was measured says the same.
    run.history.result, run.open = None, True
    assert [part.formed for part in mission_parts(run.history)] == [given[0]["formed"], given[1]["formed"]]
    # The result of a swarm says that it formed, but no round: it is measured.
    run.open = False
    run.history.result = {"formed": True, "mission_s": 7.5}
    assert mission_parts(run.history)[1].formed is not None and told(run)["tone"] == "good"
    run.history.result = {"formed": False, "mission_s": None}
    assert mission_parts(run.history)[1].formed is None and told(run)["tone"] == "bad"


def after(run: Recording, count: int, **changes: Any) -> dict[str, Any]:
    """What is told once a run has flown on for some rounds without a result, each like its last one with changes."""
    run.open, run.history.result = True, None
    for number in range(run.history.last_round + 1, run.history.last_round + 1 + count):
        state, row = run.history.states[-1], run.history.rows[-1]
        changed = {name: value for name, value in changes.items() if name != "since"}
        run.write(state.model_copy(update={"round": number, **changed}))
        run.write(row.model_copy(update={"round": number, "in_order_since": changes.get("since")}))
        run.write(RoundEnd(round=number))
    return told(run)


def test_the_banner_says_what_is_true_now_and_what_was(tmp_path: Path) -> None:
    run = flown(tmp_path, model="simulated:ideal")
    when, last = told(run)["missions"][0]["formed"], run.history.states[-1]
    slot = last.slots[3]

    def without(values: list[Any], other: Any) -> list[Any]:
        return [other if robot == 3 else value for robot, value in enumerate(values)]

    found = after(run, 2, since=when)
    assert (found["headline"], found["tone"]) == (f"Formed in round {when}", "good")
    until, was = run.history.last_round, f"Formed in rounds {when} to {run.history.last_round}, then robot 3"
    dead = {"phases": without(last.phases, "dead"), "plan_ids": without(last.plan_ids, None)}
    dead["slots"] = without(last.slots, None)
    found = after(run, 2, **dead, since=until + 1)
    assert (found["headline"], found["tone"]) == (f"{was} died; place {slot} is empty", "open")
    found = after(run, 1, **dead, since=until + 1)
    again = f"formed again in round {until + 1}; place {slot} is empty"
    assert (found["headline"], found["tone"]) == (f"{was} died; {again}", "part")
    # Another robot leaves its place: the past is told, and nothing is green.
    far = [[0.0, 0.0] if robot == 5 else place for robot, place in enumerate(last.positions)]
    found = after(run, 1, **dead, positions=far)
    gone = f"Formed in rounds {until + 1} to {until + 3}, then robot 5 left its place; place {slot} is empty"
    assert (found["headline"], found["tone"], found["formed"]) == (gone, "open", False)
    # The same at the end of the run, which had formed by its result.
    run.open, run.history.result = False, {"formed": True, "rounds_to_formed": until + 1}
    assert (told(run)["headline"], told(run)["tone"]) == (gone, "part")
    run.history.result = {"formed": False, "stopped": "rounds"}
    late = told(run)["headline"]
    assert late == f"Not formed: all {until + 4} rounds were used up; {gone[0].lower()}{gone[1:]}"


def test_a_team_that_takes_another_plan_has_to_form_again(tmp_path: Path) -> None:
    run = flown(tmp_path, model="simulated:ideal")
    when = told(run)["missions"][0]["formed"]
    until = run.history.last_round
    found = after(run, 1, plan_ids=["another"] * 6)
    assert found["headline"] == f"Formed in rounds {when} to {until}, then the team took another plan"
    assert after(run, 3, since=until + 2)["missions"][0]["formed"] == until + 2


def test_a_run_that_flies_has_not_failed(tmp_path: Path) -> None:
    run = replayed(make_record(tmp_path / "run.mcap", n=4, rounds=5, finish=False, agree=False))
    assert told(run)["headline"] == "Broke off: the record ends early"
    run.open = True
    found = told(run)
    assert (found["tone"], found["headline"], found["why"]) == ("open", "Not formed yet", "")


def test_dead_are_named_and_disagreement_blames_no_robot(tmp_path: Path) -> None:
    run = replayed(make_record(tmp_path / "run.mcap", n=4, rounds=5, agree=False))
    found = told(run)
    assert "did not agree: 4 plans" in found["why"]
    last = run.history.states[-1]
    run.history.states[-1] = last.model_copy(update={"phases": ["idle", "dead", "idle", "idle"]})
    assert told(run)["why"].startswith("Robot 1 died") and outcome(run.history, over=not run.open)["robots"] == [1]


def test_half_a_team_is_not_blamed_for_the_other_half(tmp_path: Path) -> None:
    run = replayed(make_record(tmp_path / "run.mcap", n=5, rounds=5, agree=False))
    last = run.history.states[-1]
    a, b, c = last.plan_ids[:3]
    for held, why, robots in (
        ([a, b, a, b, None], "2 plans were in use at the end; robots 0, 2 had plan A; robots 1, 3 had plan B.", []),
        (
            [a, a, c, b, b],
            "3 plans were in use at the end; robots 0, 1 had plan A; robots 3, 4 had plan B; robot 2",
            [],
        ),
        ([a, a, c, b, a], "3 plans were in use at the end; robots 2, 3 held another than most.", [2, 3]),
    ):
        phases = ["idle" if plan else "asleep" for plan in held]
        run.history.states[-1] = last.model_copy(update={"plan_ids": held, "phases": phases})
        found = told(run)
        assert why in found["why"] and found["robots"] == robots, found["why"]


def test_a_robot_that_was_accused_of_lying_comes_first(tmp_path: Path) -> None:
    run = replayed(make_record(tmp_path / "run.mcap", n=4, rounds=5, agree=False))
    said = {"robot": 2, "reason": "two_plans_of_one_name", "proof": "x"}
    run.write(ProtocolEvent(round=3, comm_round=0, robot=0, kind="accused", detail=said))
    found = told(run)
    assert found["robots"] == [2] == [found["interesting"]["robot"]]
    said = "Robot 2 was accused of sending what no honest robot sends: two plans of one name. The team did not agree: "
    assert found["why"].startswith(said)


def test_run_without_a_round_blames_no_robot(tmp_path: Path) -> None:
    found = told(flown(tmp_path / "none", model="simulated:ideal", rounds=0))
    assert (found["headline"], found["why"], found["robots"]) == ("Not formed: no round was flown", "", [])
    assert told(flown(tmp_path / "one", model="simulated:ideal", rounds=1))["headline"].endswith(
        "the only round was used up"
    )


def test_outcome_tells_empty_places_and_geometry_alone(tmp_path: Path) -> None:
    found = told(flown(tmp_path / "gap", model="simulated:ideal", kill="1@3"))
    assert found["headline"].endswith("; place 2 is empty") and found["tone"] == "part"
    assert " · robot 1 died in round 3 (killed by --kill) · plan by robot " in found["by"]
    run = flown(tmp_path / "geometry", model="geometry", places=4)
    found = told(run)
    assert found["headline"].endswith(", by geometry without models")
    assert found["missions"][0]["text"] == "circle of 4, 6 robots"
    # What no model wanted otherwise has no rim that says so.
    rims = [
        {run.history.states[frame["r"]].origins[robot] for robot in frame["h"]} for frame in frames(run.history, 0, 200)
    ]
    assert any("geometry" in state.origins for state in run.history.states) and set().union(*rims) <= {
        "shield",
        "clipped",
    }


def test_without_trouble_the_proposer_is_shown_first(tmp_path: Path) -> None:
    run = replayed(make_record(tmp_path / "run.mcap", n=4, rounds=5))
    assert told(run)["interesting"] == {"robot": 0, "why": "nothing stands out"}
    plan = run.history.states[5].plan_ids[0]
    for robot, kind, more in ((2, "proposed", {"slot": 0, "by": "model"}), (0, "adopted", {"from": 2})):
        run.write(ProtocolEvent(round=4, comm_round=0, robot=robot, kind=kind, detail={"plan": plan, **more}))
    assert told(run)["interesting"] == {
        "robot": 2,
        "why": "it proposed the plan in force",
    }
    run.write(llm_entry(5, 3, parsed=None, rejected="too far"))
    run.write(llm_entry(5, 1, parsed=None, text=None, error="timeout"))
    run.write(ProtocolEvent(round=5, comm_round=0, robot=1, kind="fallback", detail={"by": "geometry"}))
    assert told(run)["interesting"] == {"robot": 1, "why": "1 call failed, 1 time helped"}


def test_pairs_that_are_too_close_are_counted_by_round() -> None:
    fake, run = FakeRun(n=4, rounds=1), Recording("1", "test", None, live=False)

    class Crowded:
        """Puts the first three robots nearer than the safe distance (3 units) to one another."""

        def write(self, entry: Any) -> None:
            if isinstance(entry, State) and entry.round == 1:
                rows = [[10.0, 10.0], [11.0, 10.0], [12.5, 10.0], [50.0, 50.0]]
                entry = entry.model_copy(update={"positions": rows})
            if entry.__class__.__name__ == "MetricsRow" and entry.round == 1:
                entry = entry.model_copy(update={"min_separation": 1.0})
            run.write(entry)

    fake.write(Crowded())
    assert fake.mission.safe_distance == 3.0
    assert news(run, 0, 0, 0)["marks"]["1"]["too close"] == 3
    assert "too close" not in news(run, 0, 0, 0)["marks"].get("0", {})


@pytest.mark.parametrize(
    ("rows", "pairs"), [([[0, 0], [3, 0]], 0), ([[0, 0], [2.9, 0], [0, -2.9]], 2), ([[1, 1]] * 4, 6)]
)
def test_close_pairs_are_nearer_than_the_safe_distance(rows: list[list[float]], pairs: int) -> None:
    assert close_pairs(rows, 3.0) == pairs
    tall = [[x, y, 5.0 * k] for k, (x, y) in enumerate(rows)]
    assert close_pairs(tall, 3.0) == 0


def test_malformed_summary_breaks_nothing(tmp_path: Path) -> None:
    run = replayed(make_record(tmp_path / "run.mcap", n=3, rounds=2))
    for result in ({"missions": ["x"]}, {"missions": [{"formed": "x"}]}, {"missions": 3, "formed": True}):
        run.write(SummaryMessage(result=result))
        assert told(run)["headline"] and run_row(run)["outcome"]
    info = run.history.missions[0]
    run.write(MissionInfo(version=1, round=3, mission=info.mission, ideal=info.ideal))
    run.write(RoundEnd(round=2))
    assert len(told(run)["missions"]) == 2


def test_rule_without_agreement_is_blamed_and_no_robot(tmp_path: Path) -> None:
    found = outcome(
        flown(tmp_path / "alone", model="simulated:ideal", protocol="baseline", rounds=6).history, over=True
    )
    assert found["why"] == (
        "No robot is to blame: this protocol has no consensus, so each robot kept its own plan. 6 plans were in use at "
        "the end."
    )
    assert found["robots"] == [] and found["interesting"] == {"robot": 5, "why": "it kept a plan of its own"}
