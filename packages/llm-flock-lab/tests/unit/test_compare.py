"""Cells, arenas that fit, rows of figures, and how they are written down; no trial is flown here."""

import csv
import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from llm_flock import shapes as formations
from llm_flock.errors import InputError
from llm_flock.mission import Mission
from llm_flock.runtime._config import build_config
from llm_flock.runtime._result import Summary
from llm_flock_lab._experiments.compare import build_cells, compare, markdown, row, trial_file
from llm_flock_lab._experiments.grid import Cell, fitted_arena, parse_teams
from llm_flock_lab._experiments.statistics import Estimate
from llm_flock_lab._experiments.trial import TrialResult

SUMMARY = Summary(
    shape="circle",
    n_robots=10,
    seed=0,
    consensus="provenance",
    assignment="auction",
    shield=True,
    models=("simulated:ideal",),
    simulated=True,
    stopped="formed",
    reason=None,
    start_violations=0,
    rounds_to_separate=0,
    min_separation_after_start=None,
    min_clearance=None,
    nearest_read=None,
    obstacle_violations=0,
    rounds=12,
    formed=True,
    formed_by_models=True,
    rounds_to_formed=10,
    lower_bound_rounds=8,
    procrustes_mean=0.1,
    procrustes_mean_squared=0.01,
    min_separation=3.2,
    plans_in_use=1,
    distinct_goals=10,
    robots_without_plan=0,
    awake=10,
    model_calls=130,
    calls_rejected=0,
    calls_failed=0,
    faults={},
    tokens=1000,
    tokens_input=900,
    tokens_output=100,
    tokens_cached=0,
    cost_usd=0.0,
    latency_mean_s=0.001,
    waypoints={"model": 115, "shield": 5},
    waypoint_shares={"model": 115 / 120, "shield": 5 / 120},
    steps_over_limit=0,
    center_distance=0.0,
    plan_robot=3,
    plan_by="simulated:ideal",
    breakers_opened=(),
    messages_sent=600,
    bytes_per_robot_round=500.0,
    messages_rejected={},
    wall_s=0.1,
    record=None,
)
CELL = Cell(config=build_config(shape="circle", n_robots=10))


def result(summary: dict[str, object] | None, error: str | None = None) -> TrialResult:
    plain = {"id": "0", "cell": "", "axes": {}, "config": {}, "rounds": {}, "cut": False, "code": ""}
    return TrialResult(**plain, summary=summary, error=error, simulated=True)


def good(**changes: object) -> TrialResult:
    return result(replace(SUMMARY, **changes).to_dict())


def broken(error: str = "ValueError: bad") -> TrialResult:
    """A trial that broke off after it had come to some figures."""
    return result(SUMMARY.to_dict(), error)


def from_zero(*results: TrialResult) -> dict[int, TrialResult]:
    return dict(enumerate(results))


def test_teams_are_read() -> None:
    assert parse_teams("triangle/6, text:a V/ish thing/12") == [("triangle", 6), ("text:a V/ish thing", 12)]


@pytest.mark.parametrize("text", ["", "circle", "circle/", "/10", "circle/ten", "circle/-1", "circle/5,,square/4"])
def test_other_words_for_teams_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="cells"):
        parse_teams(text)


def test_cells_are_teams_by_protocols_and_share_every_option() -> None:
    cells = build_cells([("triangle", 3), ("circle", 10)], ["flock", "paper"], loss=0.3, rounds=40)
    assert [(c.shape, c.n_robots, c.protocol) for c in cells] == [
        ("triangle", 3, "flock"),
        ("triangle", 3, "paper"),
        ("circle", 10, "flock"),
        ("circle", 10, "paper"),
    ]
    assert {(c.config.links.loss, c.config.trial.rounds) for c in cells} == {(0.3, 40)}
    assert cells[0].config.protocol.consensus == "provenance" and cells[1].config.protocol.consensus == "influence"
    assert cells[0].trial(7).config == build_config(shape="triangle", n_robots=3, loss=0.3, rounds=40, seed=7)


def test_a_file_is_read_and_flags_win(tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_text("[links]\nloss = 0.1\ndelay = 2\n")
    (cell,) = build_cells([("circle", 5)], ["flock"], file=file, loss=0.2)
    assert (cell.config.links.loss, cell.config.links.delay) == (0.2, 2)


@pytest.mark.parametrize(
    ("teams", "protocols", "cause"), [([("circle", 60)], ["flock"], "^arena"), ([("circle", 5)], ["best"], "^protocol")]
)
def test_cells_reject_what_a_run_rejects(teams: list[tuple[str, int]], protocols: list[str], cause: str) -> None:
    with pytest.raises(InputError, match=cause):
        build_cells(teams, protocols)


@pytest.mark.parametrize(("shape", "n"), [("circle", 100), ("square", 100), ("grid", 1000), ("cross", 101)])
def test_fitted_arena_has_room_for_the_shape_plus_one_spacing(shape: str, n: int) -> None:
    (cell,) = build_cells([(shape, n)], ["flock"], fit_arena=True, spacing=8.0)
    mission = cell.config.mission
    assert mission.ideal is not None
    reach = formations.circumradius(mission.ideal, mission.center) + 8.0
    assert mission.arena[0] == pytest.approx((50 - reach, 50 - reach))
    assert mission.arena[1] == pytest.approx((50 + reach, 50 + reach))


def test_an_arena_that_fits_stays_and_each_team_has_its_own() -> None:
    cells = build_cells([("circle", 100), ("circle", 10)], ["flock", "paper"], fit_arena=True)
    assert cells[0].config.mission.arena == cells[1].config.mission.arena
    assert cells[2].config.mission.arena == ((0.0, 0.0), (100.0, 100.0))


def test_only_the_walls_in_the_way_are_moved() -> None:
    team = Mission(shape="text:x", n_robots=1, arena=((0, 0), (500, 100)))
    low, high = fitted_arena(team, "circle", 40)
    assert low[0] < 0 and high[0] == 500.0
    assert low[1] < 0 and high[1] > 100


def test_an_arena_for_words_has_room_for_the_starts() -> None:
    team = Mission(shape="text:x", n_robots=1)
    with pytest.raises(InputError, match="expected at most 495"):
        Mission(shape="text:x", n_robots=1500)
    arena = fitted_arena(team, "text:x", 1500)
    assert Mission(shape="text:x", n_robots=1500, arena=arena).n_robots == 1500


def test_an_arena_for_points_of_a_file(tmp_path: Path) -> None:
    file = tmp_path / "far.csv"
    file.write_text("0,0,0\n300,0,0\n")
    (cell,) = build_cells(
        [(f"points:{file}", 2)], ["flock"], fit_arena=True, center=(5.0, 5.0, 5.0), arena=((0, 0, 0), (10, 10, 10))
    )
    assert cell.config.mission.arena[1] == pytest.approx((165.0, 165.0, 165.0))


def test_a_row_says_what_its_trials_did() -> None:
    results = {
        5: good(),
        6: good(rounds_to_formed=16, min_separation=2.9, model_calls=150),
        7: good(formed=False, stopped="rounds", rounds_to_formed=None, lower_bound_rounds=None, waypoints={"hold": 3}),
        8: broken(),
    }
    found = row(CELL, results)
    assert (found.trials, found.formed.value, found.broken) == (4, 0.5, 1)
    assert found.rounds is not None and found.ratio is not None
    # The horizon is 12 rounds: seed 7 flew no more, and seed 8 broke off, which is never.
    assert (found.horizon, found.rounds.value) == (12.0, pytest.approx((10 + 12 + 12 + 12) / 4))
    assert found.ratio.value == pytest.approx((10 / 8 + 2 + 2 * 44 / 8) / 4)
    assert (found.min_separation, found.violations) == (2.9, 1)
    assert found.calls is not None and found.calls.value == pytest.approx((13 + 15 + 13) / 3)
    assert found.waypoints == {"hold": 3, "model": 230, "shield": 10}
    assert found.failed_seeds == (7, 8)
    assert found.errors == ("seed 8: ValueError: bad",)
    assert json.loads(json.dumps(asdict(found), allow_nan=False))["formed"]["value"] == 0.5


def test_the_interval_of_few_trials_holds_no_calls_below_none() -> None:
    found = row(CELL, from_zero(good(model_calls=10), good(model_calls=120)))
    assert found.calls is not None and found.calls.low == 0.0


def test_separation_rounded_too_small_is_no_violation() -> None:
    assert row(CELL, from_zero(good(min_separation=3 - 1e-7))).violations == 0
    assert row(CELL, from_zero(good(min_separation=3 - 2e-6))).violations == 1


def test_starts_too_near_are_counted_apart_from_violations() -> None:
    near = {"start_violations": 2, "min_separation": 0.5}
    later = good(**near, min_separation_after_start=3.1), good(min_separation_after_start=3.2)
    found = row(CELL, from_zero(good(), *later))
    assert (found.min_separation, found.violations) == (0.5, 1)
    assert (found.unsafe_starts, found.min_separation_after_start) == (1, 3.1)
    assert "1 of 3 began with two robots too near each other; smallest separation once they had come apart: 3.1" in (
        markdown([found])
    )
    assert "too near" not in markdown([row(CELL, from_zero(good()))])


def test_a_team_in_place_from_the_start_has_a_ratio() -> None:
    assert row(CELL, from_zero(good(rounds_to_formed=1, lower_bound_rounds=0))).ratio == Estimate(
        value=1.0, low=1.0, high=1.0
    )


def test_a_row_of_broken_trials_has_no_figures() -> None:
    found = row(CELL, from_zero(broken()))
    assert (found.formed.value, found.rounds, found.ratio, found.min_separation, found.calls) == (0.0, *[None] * 4)
    assert "| -  " in markdown([found])


def test_table_lists_the_first_failed_seeds_and_says_simulated() -> None:
    bad = {seed: good(formed=False) for seed in range(25)}
    text = markdown([row(CELL, {99: good()}), row(CELL, {**bad, 77: broken("Oops: x")})])
    lines = text.splitlines()
    assert len({len(line) for line in lines[:4]}) == 1 and lines[1].startswith("|---")
    assert "100.0 [20.7, 100.0]" in lines[2] and "| 13.00 " in lines[2] and "| 10.0 [10.0, 10.0] " in lines[2]
    assert "simulated language models" in text
    assert "26 of 26 not formed, seeds 0, 1, " in text and ", 19, and 6 more" in text
    assert "1 of these broke off: seed 77: Oops: x" in text


def test_a_line_for_each_trial(tmp_path: Path) -> None:
    path = tmp_path / "new" / "trials.csv"
    with trial_file(path) as add:
        add(CELL, 3, good())
        assert len(path.read_text().splitlines()) == 2, "an interrupted comparison keeps what was ready"
        add(CELL, 4, broken())
        add(CELL, 5, broken("=1+1\x1b\u202e"))
    with path.open() as lines:
        first, second, formula = csv.DictReader(lines)
    assert (first["protocol"], first["shape"], first["n_robots"], first["seed"]) == ("flock", "circle", "10", "3")
    assert (first["formed"], first["rounds_to_formed"], first["waypoints"]) == ("True", "10", "model=115 shield=5")
    assert (second["seed"], second["formed"], second["error"]) == ("4", "", "ValueError: bad")
    assert formula["error"] == "'=1+1\\x1b\\u202e", "a spreadsheet calculates nothing"


def test_a_file_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "trials.csv"
    path.write_text("precious")
    for wrong, reason in ((path, "overwritten"), (path / "below.csv", "written to")):
        with pytest.raises(InputError, match=reason), trial_file(wrong):
            pass
    assert path.read_text() == "precious"


def test_nothing_to_fly_and_no_process_to_fly_it() -> None:
    assert compare([], trials=1) == []
    with pytest.raises(InputError, match="jobs"):
        compare([CELL], trials=1, jobs=0)
    with pytest.raises(InputError, match="trials"):
        compare([CELL], trials=0)


def test_schedule_is_the_same_for_all_cells_and_follows_seed(tmp_path: Path) -> None:
    file = tmp_path / "flock.toml"
    file.write_text('[trial]\nkill = "4@9"\n[[trial.changes]]\nround = 9\nrobot = 2\nset = {spacing = 11}\n')
    cells = build_cells([("circle", 10)], ["flock", "baseline"], file=file, fit_arena=True, kill_random=1, places=40)
    first, second = cells
    assert first.config.mission.n_places == 40 and first.config.mission.arena[0] < (-10, -10)
    drawn = [first.trial(seed).config.schedule() for seed in range(8)]
    assert drawn == [second.trial(seed).config.schedule() for seed in range(8)]
    assert all(4 in found.kills[9] and 9 in found.missions for found in drawn)
    assert len({str(found.kills) for found in drawn}) > 1
