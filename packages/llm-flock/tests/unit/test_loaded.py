"""How many modules of ours a newcomer's first lines load: what a preset does not need is not imported."""

from __future__ import annotations

import subprocess
import sys

import pytest

LOADED = 'import sys; print(*[name for name in sys.modules if name.split(".")[0] == "llm_flock"])'
PAPER = (
    "import llm_flock; "
    'mission = llm_flock.Mission(shape="circle", n_robots=4); '
    '[llm_flock.run(mission, model="{model}", protocol=name, rounds=30) for name in ("paper", "baseline")]'
)
NOT_THE_PAPERS = ("llm_flock.protocol._membership", "llm_flock_swarm._signed", "llm_flock.roadmap")


def loaded(code: str) -> list[str]:
    ran = subprocess.run(
        [sys.executable, "-c", f"{code}; {LOADED}"], capture_output=True, text=True, timeout=120, check=True
    )
    return ran.stdout.splitlines()[-1].split()


@pytest.mark.parametrize(
    ("code", "most"),
    [("import llm_flock.algorithm1", 12), ("from llm_flock.agent import Agent", 51)],
    ids=["algorithm1", "agent"],
)
def test_the_core_loads_few_modules(code: str, most: int) -> None:
    assert len(loaded(code)) <= most


@pytest.mark.slow
@pytest.mark.parametrize(("model", "most"), [("geometry", 60), ("simulated:ideal", 102)])
def test_the_papers_rules_load_no_membership_keys_or_obstacles(model: str, most: int) -> None:
    names = loaded(PAPER.format(model=model))
    assert not [name for name in names if name.startswith(NOT_THE_PAPERS)]
    assert len(names) <= most, sorted(names)
