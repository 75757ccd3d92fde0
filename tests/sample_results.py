"""A directory of results that no sweep has flown: every way to end, and figures that are known beforehand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sample_records import FakeRun

from llm_flock.record._writer import RecordWriter
from llm_flock.runtime._config import load_config
from llm_flock.runtime._result import Summary
from llm_flock_lab._experiments import tables
from llm_flock_lab._experiments.store import Store
from llm_flock_lab._experiments.trial import TrialResult

TEAMS = (("triangle", 3), ("circle", 10))
PROTOCOLS = ("flock", "paper", "baseline")
SEEDS = 6


def summary(**changes: Any) -> dict[str, Any]:
    fields: dict[str, Any] = dict.fromkeys(Summary.__dataclass_fields__)
    counts = ("start_violations", "calls_rejected", "calls_failed", "tokens_cached", "robots_without_plan")
    fields |= dict.fromkeys(counts, 0)
    fields |= {"faults": {}, "messages_rejected": {}, "waypoints": {"model": 30}, "models": ["openai:o3-mini"]}
    fields |= {
        "killed": [],
        "joined": [],
        "missions": [],
        "simulated": False,
        "wall_s": 1.0,
        "bytes_per_robot_round": 9.0,
    }
    return fields | changes


def trial(shape: str, n: int, protocol: str, seed: int, **changes: Any) -> TrialResult:
    """`flock` forms in seed + 4 rounds; the others never do and come too near; each ends in its own way for seed 0."""
    good = protocol == "flock"
    config = load_config(None, shape=shape, n_robots=n, protocol=protocol, seed=seed, model="openai:o3-mini")
    length = seed + 5 if good else 11
    errors = [20.0 * 0.5**k + (0 if good else 3.0) for k in range(length)]
    found = summary(
        shape=shape,
        n_robots=n,
        seed=seed,
        stopped="formed" if good else ("budget" if seed == 0 else "rounds"),
        rounds=length - 1,
        formed=good,
        rounds_to_formed=seed + 4 if good else None,
        lower_bound_rounds=4 if good else None,
        procrustes_mean=errors[-1],
        min_separation=3.5 + seed if good else 0.5 * seed,
        model_calls=n * (10 if good else 40),
        tokens=n * 1000,
        tokens_input=n * 900,
        tokens_output=n * 100,
        cost_usd=0.25 * n,
        latency_mean_s=1.5,
        plans_in_use=1 if good else n,
        distinct_goals=n,
    )
    rounds: dict[str, list[Any]] = {column.name: [None] * length for column in tables.ROUNDS[1:]}
    fields: dict[str, Any] = {
        "id": f"{shape}{n}{protocol}{seed}",
        "cell": f"{shape}/{n} {protocol}",
        "axes": {},
        "config": config.model_dump(mode="json"),
        "summary": found,
        "rounds": rounds | {"round": list(range(length)), "error": errors},
        "error": None,
        "cut": False,
        "simulated": False,
        "code": "0.1.0",
    }
    if protocol == "baseline" and seed == 5:
        fields |= {"summary": None, "error": "ZeroDivisionError: in a rule", "rounds": {k: [] for k in rounds}}
    return TrialResult(**fields | changes)


def write_results(folder: Path, *, records: bool = True, **changes: Any) -> Path:
    """2 teams, 3 protocols, 6 seeds; the worst paper trial of ten robots has a record."""
    store = Store(folder)
    for shape, n in TEAMS:
        for protocol in PROTOCOLS:
            for seed in range(SEEDS):
                store.save(trial(shape, n, protocol, seed, **changes))
    if records:
        path = Path("records") / "circle10paper1.mcap"
        with RecordWriter(folder / path) as writer:
            FakeRun(n=10, rounds=6, agree=False).write(writer)
        store.save(trial("circle", 10, "paper", 1, record=str(path), **changes))
    tables.build_tables(folder)
    return folder
