"""Hashes of whole runs: equal before and after a change that must not change behaviour.

    python -m benchmarks same [--check FILE]

Each line is one run with simulated models: its name, and a hash of every position of every round, every robot's slot
and plan, the messages and bytes sent, the refusals, the model calls and the origins of the waypoints. Names of classes,
rules, flags and record fields are not part of it. Save the output of one commit and pass it to `--check` in another.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import llm_flock


def _arena(side: float) -> dict[str, Any]:
    return {"center": (side / 2, side / 2), "arena": ((0, 0), (side, side))}


_CUBE = tuple((x, y, z) for x in (0, 10) for y in (0, 10) for z in (0, 10))

CASES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "circle of ten": ({"n_robots": 10}, {"seed": 7}),
    "uniform start": ({"n_robots": 10}, {"seed": 2, "start": "uniform", "rounds": 60}),
    "square of eight, paper": ({"shape": "square", "n_robots": 8}, {"seed": 3, "protocol": "paper"}),
    "no consensus": ({"n_robots": 6}, {"seed": 5, "protocol": "baseline"}),
    "lost, late and reordered messages": (
        {"shape": "square", "n_robots": 8},
        {"seed": 4, "loss": 0.3, "delay": 2, "reorder": 0.3, "duplicate": 0.2},
    ),
    "failing models": ({"n_robots": 8}, {"seed": 6, "model": "simulated:malformed@0.3", "fallback": "geometry"}),
    "distorted and overshooting models": (
        {"n_robots": 10},
        {"seed": 8, "model": "0-4=simulated:distorted@0.5,5-9=simulated:overshoot@0.5"},
    ),
    "a robot dies": ({"n_robots": 10}, {"seed": 9, "kill": "3@6", "rounds": 60}),
    "a robot dies, the plan is made again": (
        {"n_robots": 10},
        {"seed": 4, "kill": "3@6", "gaps": "replan", "rounds": 46, "stop_when_formed": False},
    ),
    "a robot joins late": ({"n_robots": 10}, {"seed": 10, "join": "2@9", "rounds": 60}),
    "a mission in flight": (
        {"n_robots": 10, "center": (30, 40)},
        {
            "seed": 4,
            "rounds": 40,
            "stop_when_formed": False,
            "changes": [{"round": 16, "robot": 5, "set": {"velocity": [2, 1]}}],
        },
    ),
    "obstacles": (
        {"n_robots": 6, "obstacles": [{"center": (30, 30), "radius": 5}, {"center": (70, 40), "radius": 6}]},
        {"seed": 11, "start": "uniform", "rounds": 60},
    ),
    "asked on events, in space": (
        {"points": _CUBE, "center": (50, 50, 50), "arena": ((0, 0, 0), (100, 100, 100))},
        {"seed": 12, "decide": "on-event", "rounds": 60},
    ),
    "noisy sensors": ({"n_robots": 6, "sense_range": 20}, {"seed": 13, "noise": 0.2, "rounds": 60}),
    "fewer places than robots": ({"n_robots": 9, "places": 7}, {"seed": 14, "rounds": 60}),
    "grid of forty": (
        {"shape": "grid", "n_robots": 40, **_arena(200)},
        {"seed": 15, "start": "uniform", "rounds": 120},
    ),
    "circle of a hundred": ({"n_robots": 100, **_arena(450)}, {"seed": 16, "rounds": 200}),
}


def fingerprint(mission: dict[str, Any], options: dict[str, Any], *, sizes: bool = True) -> str:
    """Hash of one run, with or without the sizes of its messages."""
    result = llm_flock.run(llm_flock.Mission(**mission), **options)
    summary = result.summary
    content = {
        "slots": result.slots,
        "plans": [None if plan is None else plan.digest for plan in result.plans],
        "rounds": [summary.rounds, summary.rounds_to_formed, summary.lower_bound_rounds],
        "calls": [summary.model_calls, summary.calls_rejected, summary.calls_failed, summary.tokens],
        "waypoints": sorted(summary.waypoints.items()),
        "messages": [
            summary.messages_sent,
            *([summary.bytes_per_robot_round] if sizes else []),
            sorted(summary.messages_rejected.items()),
        ],
    }
    digest = hashlib.blake2b(result.positions.tobytes(), digest_size=12)
    digest.update(json.dumps(content).encode())
    return digest.hexdigest()


def main(arguments: Sequence[str] = ()) -> None:
    """Print a line for each case; with `--check FILE`, end with an error if one differs from that file's."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks same", description=__doc__)
    parser.add_argument("--check", type=Path, help="output of another commit")
    parser.add_argument("--only", default="", help="only cases whose name contains this")
    parser.add_argument("--no-sizes", action="store_true", help="leave the sizes of messages out")
    chosen = parser.parse_args(arguments)
    known = {} if chosen.check is None else dict(_lines(chosen.check.read_text()))
    different = []
    for name, (mission, options) in CASES.items():
        if chosen.only not in name:
            continue
        found = fingerprint(mission, options, sizes=not chosen.no_sizes)
        verdict = "" if not known else "  same" if known.get(name) == found else "  DIFFERENT"
        different += [name] if verdict.endswith("DIFFERENT") else []
        print(f"{found}  {name}{verdict}", flush=True)
    if different:
        raise SystemExit(f"{len(different)} runs differ: {', '.join(different)}")


def _lines(text: str) -> list[tuple[str, str]]:
    pairs = (line.split("  ")[:2] for line in text.splitlines())
    return [(name, found) for found, name in pairs]
