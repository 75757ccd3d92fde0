"""Sweeps from their file to their tables: each trial once, in any place and with any interruption."""

from pathlib import Path
from typing import Any

import msgspec
import pytest
from integration.fault_server import running
from sweeps import results, small, small_file

from llm_flock.errors import InputError
from llm_flock.record._reader import read_record
from llm_flock_lab._experiments import tables
from llm_flock_lab._experiments.store import Store, trial_files
from llm_flock_lab._experiments.sweep import fly_sweep
from llm_flock_lab._experiments.tally import expect_cells
from llm_flock_lab._experiments.trial import TrialResult


def test_one_process_and_a_pool_give_identical_tables(tmp_path: Path) -> None:
    sweep = small(tmp_path, seeds=1, more="[run.links]\nloss = 0.2")
    assert fly_sweep(sweep, tmp_path / "one", executor="one").complete
    assert fly_sweep(sweep, tmp_path / "pool", executor="pool", jobs=2).complete
    one, pool = results(tmp_path / "one"), results(tmp_path / "pool")
    assert one[0].equals(pool[0]) and one[1].equals(pool[1])
    assert one[0].height == 2 and one[0]["formed"].sum() == 1
    assert one[0]["simulated"].all() and one[0]["code"].null_count() == 0


def test_trials_that_take_turns_give_what_they_give_one_by_one(tmp_path: Path) -> None:
    sweep = small(tmp_path, seeds=2, model="simulated:slow@0.01,flaky@0.02", rounds=4)
    for name, at_once in (("together", 256), ("alone", 1)):
        assert fly_sweep(sweep, tmp_path / name, at_once=at_once).complete
    together, alone = results(tmp_path / "together"), results(tmp_path / "alone")
    assert together[0].equals(alone[0]) and together[1].equals(alone[1])


def test_the_rounds_are_those_of_the_record(tmp_path: Path) -> None:
    sweep = small(tmp_path, seeds=1, sweep='keep_records = "failed"')
    fly_sweep(sweep, tmp_path / "out", executor="one")
    trials, rounds = tables.read_trials(tmp_path / "out"), tables.read_rounds(tmp_path / "out")
    assert trials["record"].null_count() == 1, "the one that formed"
    (row,) = trials.filter(~trials["formed"]).to_dicts()
    record = read_record(tmp_path / "out" / row["record"])
    mine = rounds.filter(rounds["trial"] == row["trial"])
    assert mine["round"].to_list() == [entry.round for entry in record.metrics]
    assert mine["error"].to_list() == [entry.procrustes_mean for entry in record.metrics]
    assert min(mine["min_separation"].to_list()) == pytest.approx(row["min_separation"])
    assert mine["calls"][-1] == row["model_calls"] and mine["tokens"][-1] == row["tokens"]
    assert [path.name for path in (tmp_path / "out/records").iterdir()] == [f"{row['trial']}.mcap"]


def test_finished_trials_are_never_reflown_more_seeds_may_come(tmp_path: Path) -> None:
    out = tmp_path / "out"
    fly_sweep(small(tmp_path, seeds=1), out, executor="one")
    before = {path.name: path.stat().st_mtime_ns for path in trial_files(out)}
    status = fly_sweep(small(tmp_path, seeds=2), out, executor="one")
    assert (status.trials, status.finished) == (4, 4)
    after = {path.name: path.stat().st_mtime_ns for path in trial_files(out)}
    assert len(after) == 4 and {name: after[name] for name in before} == before
    with pytest.raises(InputError, match="2 of its 4 trials are not in what was given"):
        fly_sweep(small(tmp_path, seeds=1), out, executor="one")
    with pytest.raises(InputError, match="another directory"):
        fly_sweep(small(tmp_path, seeds=2, rounds=14), out, executor="one")
    assert (out / "sweep.toml").read_text() == small_file(tmp_path, seeds=2).read_text()


def test_broken_trials_are_counted_and_redone_on_request(tmp_path: Path) -> None:
    sweep = small(tmp_path, seeds=1, consensus="rules_that_fail:Raising", start="uniform")
    status = fly_sweep(sweep, tmp_path / "out", executor="one")
    assert (status.finished, status.broken, status.formed, status.complete) == (2, 2, 0, True)
    found = tables.read_trials(tmp_path / "out")
    assert ["'raising' failed: Unpicklable: no choice" in text for text in found["error"]] == [True] * 2
    assert found["stopped"].to_list() == ["failed"] * 2 and found["earlier_tries"].to_list() == [0, 0]
    assert found["model_calls"].to_list() == [3, 3], "what they had used until then"
    fly_sweep(sweep, tmp_path / "out", executor="one")
    assert tables.read_trials(tmp_path / "out")["earlier_tries"].to_list() == [0, 0]
    fly_sweep(sweep, tmp_path / "out", executor="one", again=True)
    assert tables.read_trials(tmp_path / "out")["earlier_tries"].to_list() == [1, 1]


def test_a_budget_ends_a_sweep_and_a_larger_one_goes_on(tmp_path: Path) -> None:
    out = tmp_path / "out"
    status = fly_sweep(small(tmp_path, budget={"max_calls": 60}), out, jobs=2)
    assert not status.complete and status.cut == 1
    assert status.reason == "max_calls = 60 of the sweep is used up"
    cut = tables.read_trials(out).filter(tables.read_trials(out)["cut"])
    assert cut["stopped"].to_list() == ["budget"] and not cut["formed"].any()
    assert sum(tables.read_trials(out)["model_calls"].to_list()) == 60
    again = fly_sweep(small(tmp_path, budget={"max_calls": 60}), out)
    assert again.finished == status.finished and tables.read_trials(out)["earlier_tries"].sum() == 0
    assert fly_sweep(small(tmp_path), out, executor="one").complete
    whole = tables.read_trials(out)
    assert whole.height == 4 and not whole["cut"].any() and whole["earlier_tries"].sum() == 1
    with pytest.raises(InputError, match="executor"):
        fly_sweep(small(tmp_path, budget={"max_calls": 60}), out, executor="pool")


def test_a_directory_takes_one_sweep_at_a_time(tmp_path: Path) -> None:
    sweep, out = small(tmp_path, seeds=1), tmp_path / "out"
    with Store(out).held(), pytest.raises(InputError, match="no other sweep works"):
        fly_sweep(sweep, out, executor="one")
    assert fly_sweep(sweep, out, executor="one").complete


def test_many_trials_wait_for_one_server_within_its_rates(tmp_path: Path) -> None:
    more = "[providers.openai-compatible]\nmax_concurrent = 7\n[variables]\nmodels = ['openai-compatible:x']"
    with running(latency=0.02) as server:
        address = server.base_url
        grid = 'model = "$models"'
        sweep = small(tmp_path, seeds=4, grid=grid, more=more, base_url=address, rounds=3)
        assert all(trial.waits for trial in sweep.trials)
        assert fly_sweep(sweep, tmp_path / "out").complete
    found = tables.read_trials(tmp_path / "out")
    assert found.height == 8 and found["calls_failed"].sum() == 0
    assert not found["simulated"].any()


def test_missing_key_is_reported_before_anything_is_made(tmp_path: Path) -> None:
    sweep = small(tmp_path, model="openai:gpt-4o")
    with pytest.raises(InputError, match="OPENAI_API_KEY"):
        fly_sweep(sweep, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    with pytest.raises(InputError, match="max_cost"):
        fly_sweep(small(tmp_path, model="vllm:x", budget={"max_cost": 1.0}), tmp_path / "out")


def test_cost_of_real_models_is_estimated_by_stand_ins(tmp_path: Path) -> None:
    sweep = small(tmp_path, model="openai:gpt-4o", more="[expect]\noutput_tokens = 100\nprofile = 'ideal'")
    expected = expect_cells(sweep)
    free = expect_cells(small(tmp_path))
    assert set(expected) == {spec.cell for spec in sweep.trials}
    for cell, found in expected.items():
        assert found.calls == free[cell].calls and found.tokens_input == free[cell].tokens_input
        assert found.tokens_output == 100 * found.calls and found.calls <= found.at_most
        assert found.cost_usd == pytest.approx(found.tokens_input * 2.5e-6 + found.tokens_output * 1e-5, rel=0.05)
        assert free[cell].cost_usd == 0
    unknown = expect_cells(small(tmp_path, model="vllm:x"))
    assert all(found.cost_usd is None for found in unknown.values())
    total = sum((found.times(2) for found in expected.values()), start=expected[sweep.trials[0].cell].times(0))
    assert total.calls == 2 * sum(found.calls for found in expected.values())


def test_cells_with_flown_trials_are_expected_to_go_on_like_that(tmp_path: Path) -> None:
    sweep = small(tmp_path)
    fly_sweep(sweep, tmp_path / "out", executor="one")
    flown: dict[str, list[Any]] = {}
    for path in trial_files(tmp_path / "out"):
        trial = msgspec.json.decode(path.read_bytes(), type=TrialResult)
        flown.setdefault(trial.cell, []).append(trial)
    found = tables.read_trials(tmp_path / "out")
    for cell, expected in expect_cells(sweep, flown=flown).items():
        assert expected.calls == pytest.approx(found.filter(found["cell"] == cell)["model_calls"].mean())
