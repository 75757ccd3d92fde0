"""Trials in a pool of processes: the same as in one, in order, and none of them lost."""

import multiprocessing
from dataclasses import replace

import pytest

import llm_flock
from llm_flock.errors import FlockError, InputError
from llm_flock.experiments.compare import build_cells, compare
from llm_flock.experiments.trials import Outcome, run_trials
from llm_flock.runtime.config import build_config
from llm_flock.runtime.result import Summary


def timeless(summary: Summary | None) -> Summary:
    """Without what the clock decides."""
    assert summary is not None
    return replace(summary, wall_s=0.0, latency_mean_s=0.0)


def test_a_pool_gives_what_single_runs_give_in_the_order_of_seeds() -> None:
    configs = [build_config(shape="triangle", n_robots=3, seed=seed, loss=0.2) for seed in (5, 3, 4)]
    told: list[Outcome] = []
    outcomes = run_trials(configs, jobs=2, on_outcome=told.append)
    assert [o.seed for o in outcomes] == [5, 3, 4] and told == outcomes
    alone = [llm_flock.run(config=config).summary for config in configs]
    assert [timeless(o.summary) for o in outcomes] == [timeless(summary) for summary in alone]
    assert multiprocessing.active_children() == []


def test_trials_that_break_off_are_counted_with_their_reason() -> None:
    cells = build_cells([("triangle", 3)], ["flock"], consensus="rules_that_fail:Raising", start="uniform")
    (row,) = compare(cells, trials=3, first_seed=20, jobs=1)
    assert (row.trials, row.broken, row.formed.value) == (3, 3, 0.0)
    assert row.failed_seeds == (20, 21, 22)
    assert row.errors == ("seed 20: Unpicklable: no choice",)


def test_a_refused_trial_ends_it_all_with_the_reason() -> None:
    with pytest.raises(InputError, match="model = 'nobody:x'"):
        run_trials([build_config(model="nobody:x")] * 3, jobs=1)
    assert multiprocessing.active_children() == []


def test_a_killed_worker_is_told() -> None:
    with pytest.raises(FlockError, match="killed after 0 trials"):
        run_trials([build_config(consensus="rules_that_fail:Killing")] * 3, jobs=1)
    assert multiprocessing.active_children() == []
