"""Comparisons in a pool of processes: the same as single runs, in order, and no trial lost."""

import multiprocessing
from typing import Any

import pytest

import llm_flock
from llm_flock.errors import FlockError, InputError
from llm_flock.runtime._config import build_config
from llm_flock_lab._experiments.compare import build_cells, compare
from llm_flock_lab._experiments.grid import Cell
from llm_flock_lab._experiments.trial import TrialResult


def timeless(summary: dict[str, Any] | None) -> dict[str, Any]:
    """Without what the clock decides."""
    assert summary is not None
    return {**summary, "wall_s": 0.0, "latency_mean_s": 0.0}


def test_pool_gives_single_run_results_by_cells_and_seeds() -> None:
    cells = build_cells([("square", 8), ("triangle", 3), ("triangle", 3)], ["flock"], loss=0.2)
    told: list[tuple[str, int, TrialResult]] = []
    rows = compare(
        cells, trials=2, first_seed=3, jobs=2, on_result=lambda cell, *rest: told.append((cell.shape, *rest))
    )
    order = [("square", 8, 3), ("square", 8, 4), *2 * [("triangle", 3, 3), ("triangle", 3, 4)]]
    assert [(shape, seed) for shape, seed, _ in told] == [(shape, seed) for shape, _, seed in order]
    for (_, _, result), (shape, n, seed) in zip(told, order, strict=True):
        alone = llm_flock.run(config=build_config(shape=shape, n_robots=n, seed=seed, loss=0.2)).summary
        assert result.summary is not None
        measured = {"distance_flown", "distance_least"}
        assert timeless(alone.to_dict()) == timeless({k: v for k, v in result.summary.items() if k not in measured})
    assert [(row.shape, row.trials) for row in rows] == [("square", 2), ("triangle", 2), ("triangle", 2)]
    assert rows[1] == rows[2], "the same cell may be asked for twice"
    assert multiprocessing.active_children() == []


def test_trials_that_break_off_are_counted_with_their_reason() -> None:
    cells = build_cells([("triangle", 3)], ["flock"], consensus="rules_that_fail:Raising", start="uniform")
    (row,) = compare(cells, trials=3, first_seed=20, jobs=1)
    assert (row.trials, row.broken, row.formed.value) == (3, 3, 0.0)
    assert row.failed_seeds == (20, 21, 22)
    (said,) = row.errors
    assert said.startswith("seed 20: FlockError: robot 0: the consensus rule 'raising' failed: Unpicklable: no choice")


def test_a_trial_that_cancels_itself_breaks_off() -> None:
    """The sweep around it ended, without a word why."""
    (row,) = compare(
        build_cells([("triangle", 3)], ["flock"], consensus="rules_that_fail:Cancelling"), trials=2, jobs=1
    )
    assert (row.trials, row.broken) == (2, 2) and row.errors[0].startswith("seed 0: CancelledError")


def test_a_refused_trial_ends_it_all_with_the_reason() -> None:
    with pytest.raises(InputError, match="model = 'nobody:x'") as refused:
        compare([Cell(config=build_config(model="nobody:x"))], trials=3)
    assert refused.value.field == "model"
    assert multiprocessing.active_children() == []


def test_killed_worker_is_reported() -> None:
    with pytest.raises(FlockError, match="killed after 0 trials"):
        compare([Cell(config=build_config(consensus="rules_that_fail:Killing"))], trials=3)
    assert multiprocessing.active_children() == []
