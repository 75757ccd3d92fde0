"""Parts that can be left out, and models that err alike: each switch takes away what it names, and only that."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import llm_flock
from llm_flock.record import Entry, ProtocolEvent
from llm_flock.runtime import RunResult


class Notes(list[str]):
    """The kinds of all notes of a run."""

    def write(self, entry: Entry) -> None:
        if isinstance(entry, ProtocolEvent):
            self.append(entry.kind)


def fly(seed: int, **options: Any) -> tuple[RunResult, Notes]:
    notes = Notes()
    return llm_flock.run(seed=seed, sink=notes, trace=False, **options), notes


def test_without_the_search_nobody_looks_for_others() -> None:
    assert any("search" in fly(seed, n_robots=10)[1] for seed in range(3))
    assert not any("search" in fly(seed, n_robots=10, without="search")[1] for seed in range(3))


@pytest.fixture(scope="module")
def whole() -> list[RunResult]:
    return [fly(seed, n_robots=10)[0] for seed in range(3)]


@pytest.mark.parametrize("without", ["exchanges", "path-cost", "joint-assignment"])
def test_an_auction_without_a_part_flies_otherwise_and_forms(whole: list[RunResult], without: Any) -> None:
    less = [fly(seed, n_robots=10, without=without)[0] for seed in range(3)]
    assert any(not np.array_equal(a.positions[:9], b.positions[:9]) for a, b in zip(whole, less, strict=True))
    assert all(result.formed for result in less)
    sent = [sum(result.summary.bytes_per_robot_round for result in results) for results in (less, whole)]
    assert without != "joint-assignment" or sent[0] < 0.95 * sent[1], "no positions are reported"


def test_models_that_err_alike_distort_their_plans_alike() -> None:
    options: dict[str, Any] = {"n_robots": 6, "protocol": "baseline", "rounds": 1}
    alike = fly(3, **options, model="simulated:distorted@0.5,alike")[0]
    apart = fly(3, **options, model="simulated:distorted@0.5")[0]
    assert alike.summary.plans_in_use == 1 and apart.summary.plans_in_use == 6


@pytest.mark.parametrize("seed", range(2))
def test_a_run_says_whether_it_formed_by_other_tolerances(seed: int) -> None:
    summary = fly(seed, n_robots=6, model="simulated:overshoot@0.5")[0].summary
    assert summary.formed and summary.formed_twice_tolerance >= summary.formed >= summary.formed_half_tolerance
