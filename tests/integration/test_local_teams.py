"""Many runs, or many processes, with models on board: they share one engine, or are refused."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from swarms import swarm_config
from sweeps import small, small_file

from llm_flock.errors import InputError
from llm_flock.runtime._config import build_config
from llm_flock.runtime._planners import TeamPlanners
from llm_flock_lab._experiments import executors
from llm_flock_lab._experiments.compare import build_cells, compare
from llm_flock_lab._experiments.sweep_file import load_sweep
from llm_flock_lab._experiments.tally import expect_cells
from llm_flock_onboard._local.engine import ENGINES
from llm_flock_onboard._local.weights import find_weights
from llm_flock_swarm._network.swarm import run_swarm

pytest.importorskip("xllamacpp")
pytestmark = pytest.mark.usefixtures("own_cache")

STOCK = "local:smollm2+none"


def test_a_trial_is_another_one_when_its_weights_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def ids() -> set[str]:
        return {spec.id for spec in load_sweep(small_file(tmp_path), model=STOCK).trials}

    before = ids()
    assert ids() == before
    monkeypatch.setattr(type(find_weights("smollm2")), "digests", lambda self: {"model.gguf": "sha256:0"})
    assert not ids() & before


def test_use_of_a_sweep_is_estimated_without_an_engine(tmp_path: Path) -> None:
    sweep = small(tmp_path, model=STOCK, prompts="brief", frame="own", more="[expect]\noutput_tokens = 20")
    for found in expect_cells(sweep).values():
        assert found.calls > 0 and found.cost_usd == 0.0
        assert found.tokens_output == 20 * found.calls
    assert ENGINES.running == 0


def test_processes_of_a_comparison_would_take_each_others_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    jobs: list[int] = []

    class Refused(Exception):
        pass

    def pool(count: int, **_: object) -> None:
        jobs.append(count)
        raise Refused

    monkeypatch.setattr(executors, "ProcessPoolExecutor", pool)
    for model, expected in ((STOCK, 1), ("0=local:smollm2,1-9=simulated:ideal", 1), ("simulated:ideal", 3)):
        with pytest.raises(Refused):
            compare(build_cells([("circle", 10)], ["flock"], model=model), trials=4, jobs=3)
        assert jobs.pop() == expected


def test_a_swarm_on_one_machine_has_one_robot_on_board_at_most() -> None:
    config = swarm_config(3, model=STOCK)
    with pytest.raises(InputError, match="`run` has one engine for all robots"):
        asyncio.run(run_swarm(config))


def test_files_are_looked_into_before_anything_is_asked(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a file that is there"):
        TeamPlanners(build_config(model=f"local:{tmp_path}/none.gguf"))
    planners = TeamPlanners(build_config(model="0=local:smollm2+none,1-9=simulated:ideal"))
    assert not ENGINES.running and planners.simulated
    assert planners.weights == find_weights("smollm2+none").versions()
    asyncio.run(planners.close())
