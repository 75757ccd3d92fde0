"""Records of runs that never took place: robots walk straight to a circle while plans spread along it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from llm_flock import graph
from llm_flock.mission import build_mission
from llm_flock.plan import Plan
from llm_flock.record._schema import (
    CallUsage,
    ChatLine,
    LlmEntry,
    MetricsRow,
    MissionInfo,
    PlanInfo,
    ProtocolEvent,
    RecordSink,
    RoundEnd,
    RunInfo,
    State,
    SummaryMessage,
)
from llm_flock.record._writer import RecordWriter


def run_info(seed: int = 0, **changes: Any) -> RunInfo:
    fields: dict[str, Any] = {
        "format_version": 1,
        "config": {"model": {"model": "simulated:ideal", "base_url": None}},
        "versions": {"numpy": "2.0"},
        "git_revision": None,
        "seed": seed,
        "simulated": True,
        "created_at": "2030-01-01T00:00:00+00:00",
        "environment": {"python": "3.11"},
    }
    return RunInfo(**fields | changes)


def llm_entry(round_number: int, robot: int, **changes: Any) -> LlmEntry:
    fields: dict[str, Any] = {
        "round": round_number,
        "robot": robot,
        "kind": "step",
        "attempt": 0,
        "model": "simulated:ideal",
        "request_hash": "0" * 16,
        "messages": [ChatLine(role="system", text="You are a robot."), ChatLine(role="user", text="x" * 1200)],
        "text": "Position: [1.0, 2.0]",
        "parsed": {"waypoint": [1.0, 2.0]},
        "rejected": None,
        "error": None,
        "settings": {"temperature": None},
        "usage": CallUsage(input=300, output=20, cached=0),
        "cost_usd": None,
        "latency_s": 0.25,
        "faults": [],
    }
    return LlmEntry(**fields | changes)


class FakeRun:
    """A whole run in the order in which a real one is recorded.

    Args:
        n: number of robots.
        rounds: motion rounds.
        seed: seed of starts and plans.
        agree: whether the robots settle on one plan.
        dim: dimension of space.
    """

    def __init__(self, n: int = 10, rounds: int = 10, seed: int = 0, *, agree: bool = True, dim: int = 2) -> None:
        rng = np.random.default_rng(seed)
        self.rounds, self.seed, self.agree, self.dim = rounds, seed, agree, dim
        side = max(100.0, 10.0 * n)
        self.mission = build_mission(n_robots=n, center=(side / 2, side / 2), arena=((0.0, 0.0), (side, side)))
        ideal = np.array(self.mission.ideal)
        self.ideal = self._lifted(ideal)
        self.start = rng.uniform(0.1 * side, 0.9 * side, (n, dim))
        self.plans: list[Plan] = []
        for angle in rng.uniform(0.0, 2.0 * np.pi, n):
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            self.plans.append(Plan.of(self._lifted((ideal - side / 2) @ turn.T + side / 2)))

    def _lifted(self, flat: np.ndarray) -> np.ndarray:
        return np.hstack([flat, np.full((len(flat), self.dim - 2), 20.0)])

    def write(self, sink: RecordSink, *, finish: bool = True, llm: bool = True) -> None:
        sink.write(run_info(self.seed))
        mission = self.mission.model_dump(mode="json")
        low, high = mission["arena"]
        mission["arena"] = [[*low, *low[: self.dim - 2]], [*high, *high[: self.dim - 2]]]
        sink.write(MissionInfo(version=0, round=0, mission=mission, ideal=self.ideal.tolist()))
        for number in range(self.rounds + 1):
            self.write_round(sink, number, llm=llm)
        if finish:
            result = {
                "formed": self.agree,
                "rounds": self.rounds,
                "missions": [{"formed": self.rounds if self.agree else None}],
                "wall_s": 1.5,
                "cost_usd": None,
            }
            sink.write(SummaryMessage(result=result))

    def write_round(self, sink: RecordSink, number: int, *, llm: bool = True) -> None:
        n = self.mission.n_robots
        # A plan spreads by one robot to each side in each round, starting from robot 0.
        leaders = [0 if self.agree and min(i, n - i) < number else i for i in range(n)]
        if number == 1:
            for robot, plan in enumerate(self.plans):
                sink.write(PlanInfo(round=1, plan_id=plan.digest, proposer=robot, points=plan.array.tolist()))
        if number:
            for robot in range(n if llm else 0):
                sink.write(llm_entry(number, robot))
            for robot in range(n):
                sink.write(
                    ProtocolEvent(
                        round=number, comm_round=0, robot=robot, kind="adopted", detail={"plan": None, "from": 1}
                    )
                )
        goals = np.array([self.plans[leader].points[i] for i, leader in enumerate(leaders)])
        share = 0.0 if not self.rounds else min(1.0, 1.2 * number / self.rounds)
        positions = self.start + share * (goals - self.start)
        none: list[Any] = [None] * n
        sink.write(
            State(
                round=number,
                positions=positions.tolist(),
                goals=goals.tolist() if number else none,
                slots=list(range(n)) if number else none,
                plan_ids=[self.plans[leader].digest for leader in leaders] if number else none,
                influence=graph.adjacency(positions, self.mission.comm_range).mean(axis=1).tolist(),
                waypoints=positions.tolist() if number else none,
                origins=["model" if number else "start"] * n,
                phases=["idle"] * n,
            )
        )
        distances = graph.distances(positions) + np.diag(np.full(n, np.inf))
        error = float(np.linalg.norm(positions - goals, axis=1).mean())
        sink.write(
            MetricsRow(
                round=number,
                procrustes_mean=error,
                procrustes_mean_squared=error**2,
                min_separation=float(distances.min()) if n > 1 else None,
                segment_separation=None,
                plans_in_use=len(set(leaders)) if number else 0,
                distinct_goals=n if number else 0,
                robots_at_goal=n if share == 1.0 else 0,
                in_order_since=None,
                connected=False,
                model_calls=n * number,
                tokens=320 * n * number,
                cost_usd=None,
                messages_sent=5 * n * number,
                bytes_sent=5 * n * number * 200,
                messages_rejected={},
            )
        )
        sink.write(RoundEnd(round=number))


def make_record(path: Path, *, finish: bool = True, llm: bool = True, **fake: Any) -> Path:
    """Write a fake run to `path`."""
    with RecordWriter(path) as writer:
        FakeRun(**fake).write(writer, finish=finish, llm=llm)
    return path
