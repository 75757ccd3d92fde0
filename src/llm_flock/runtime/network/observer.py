"""What an observer makes of frames and reports: figures, a record, and whether the team has formed.

It only listens. A swarm flies the same with one, with several, or with none.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from llm_flock import graph, metrics
from llm_flock.errors import FlockError
from llm_flock.mission import Mission
from llm_flock.protocol.events import Origin
from llm_flock.record.schema import ASLEEP, DEAD, LlmEntry, PlanInfo, ProtocolEvent, RoundEnd, State
from llm_flock.record.writer import RecordSink
from llm_flock.runtime.entries import metrics_row, mission_info
from llm_flock.runtime.network.config import SwarmConfig
from llm_flock.runtime.network.wire import Frame, Report
from llm_flock.runtime.trial import TrialProgress

Row = list[float]


@dataclass(slots=True)
class Figures:
    """Totals of what was seen."""

    min_separation: float = float("inf")
    calls: int = 0
    calls_failed: int = 0
    tokens: int = 0
    late_commands: int = 0
    latencies_s: list[float] = field(default_factory=list[float])


class Observer:
    """Follows one swarm.

    Args:
        config: the swarm.
        sink: takes the record.
        on_row: told of every row of the record.
    """

    def __init__(
        self, config: SwarmConfig, sink: RecordSink, on_row: Callable[[TrialProgress], None] | None = None
    ) -> None:
        self.mission = config.mission
        self.figures = Figures()
        self.began_s: float | None = None
        self.formed_s: float | None = None
        self.in_order = False
        self.alive: set[int] = set()
        self.reports: dict[int, Report] = {}
        self._config = config
        self._sink = sink
        self._on_row = on_row
        self._frame: Frame | None = None
        self._row = -1
        self._row_due = 0.0
        self._row_closest = float("inf")
        self._since_s: float | None = None
        self._checks = 0
        self._counter = 0
        self._plans: set[str] = set()
        self._places: dict[str, int] = {}
        self._seen: set[int] = set()
        self._target = self._shape()
        self._tracker = metrics.FormedTracker(spacing=self.mission.spacing)
        self._missions = 0

    # ---------------------------------------------------------------- what comes in

    def comes_or_goes(self, robot: int, comes: bool) -> None:
        """A process of the swarm came or went: the team has to form once more."""
        if 0 <= robot < self.mission.n_robots:
            (self.alive.add if comes else self.alive.discard)(robot)
            self._disturb()

    def _disturb(self) -> None:
        self.formed_s, self._since_s = None, None
        self._tracker = metrics.FormedTracker(spacing=self.mission.spacing)

    def frame(self, frame: Frame) -> None:
        """The bodies, as they are."""
        if len(frame.bodies) != self.mission.n_robots:
            return
        self._frame = frame
        self.figures.min_separation = min(self.figures.min_separation, frame.closest)
        self.figures.late_commands = frame.late
        self._row_closest = min(self._row_closest, frame.closest)

    def report(self, robot: int, report: Report) -> None:
        """A robot's account of itself."""
        if not 0 <= robot < self.mission.n_robots:
            return
        self.reports[robot] = report
        if report.round and self.began_s is None:
            self.began_s = report.stamp
        if report.shape is not None and report.mission[0] > self._counter:
            self._new_mission(report)
        if report.plan_id is not None and report.points is not None and report.plan_id not in self._plans:
            self._plans.add(report.plan_id)
            self._places[report.plan_id] = len(report.points)
            points = [list(point) for point in report.points]
            proposer = report.proposer or 0
            self._sink.write(PlanInfo(round=self._now, plan_id=report.plan_id, proposer=proposer, points=points))
        for event in report.happened:
            told = ProtocolEvent(round=self._now, comm_round=None, robot=robot, kind=event.kind, detail=event.detail)
            self._sink.write(told)
        for call in report.calls:
            entry = LlmEntry.model_validate({**call, "round": self._now})
            self._sink.write(entry)
            self.figures.calls += 1
            self.figures.calls_failed += entry.error is not None
            self.figures.tokens += entry.usage.input + entry.usage.output
        self.figures.latencies_s.extend(report.latencies_s)

    @property
    def _now(self) -> int:
        return max(self._row, 0)

    def _new_mission(self, report: Report) -> None:
        try:
            mission = Mission.model_validate(report.shape)
        except (ValueError, FlockError):
            return
        self._counter, self.mission = report.mission[0], mission
        self._target = self._shape()
        self._disturb()
        self._tell_mission(self._now + 1)

    def _tell_mission(self, first: int) -> None:
        self._sink.write(mission_info(self.mission, self._missions, first))
        self._missions += 1

    def _shape(self) -> metrics.ShapeTarget | None:
        ideal = self.mission.ideal
        return None if ideal is None else metrics.ShapeTarget(np.array(ideal))

    # ---------------------------------------------------------------- what is made of it

    def check(self, now: float) -> None:
        """Look whether the team is in order; once in the time of a step, write a row of the record."""
        if self._frame is None:
            return
        self._look(now)
        if now >= self._row_due:
            self._row_due = max(self._row_due + self._config.network.step_s, now)
            self._write()

    @property
    def robots(self) -> list[int]:
        """Robots that are there and have said something, by id."""
        return sorted(self.alive & self.reports.keys())

    def _look(self, now: float) -> None:
        robots, frame = self.robots, self._frame
        assert frame is not None
        if not robots:
            self.in_order, self._since_s = False, None
            return
        told = [self.reports[robot] for robot in robots]
        distances = self._distances()
        places = self._places.get(told[0].plan_id or "", self.mission.n_places)
        blocked = {slot for report in told for slot in report.blocked}
        self._checks += 1
        stamp = (max(report.mission[0] for report in told), self.mission.digest)
        self._tracker.update(
            self._checks,
            plan_ids=[report.plan_id if tuple(report.mission) == stamp else None for report in told],
            slots=[report.slot for report in told],
            goal_distances=[distances[robot] for robot in robots],
            residual=self._residual(),
            usable=places - len(blocked),
        )
        self.in_order = self._tracker.in_order
        if not self.in_order:
            self._since_s = None
            return
        self._since_s = now if self._since_s is None else self._since_s
        held_s = metrics.HELD_ROUNDS * self._config.network.step_s
        if self.formed_s is None and now - self._since_s >= held_s:
            self.formed_s = self._since_s

    def _distances(self) -> dict[int, float]:
        frame = self._frame
        assert frame is not None
        return {
            robot: float("inf")
            if (goal := self.reports[robot].goal) is None
            else float(np.linalg.norm(np.subtract(frame.bodies[robot].position, goal)))
            for robot in self.robots
        }

    def _residual(self) -> float | None:
        """Mean distance to the ideal shape; with gaps the places that are filled are what counts."""
        robots, frame = self.robots, self._frame
        assert frame is not None
        if self._target is None or len(robots) != self.mission.n_places:
            return None
        return self._target.error([frame.bodies[robot].position for robot in robots]).mean

    def _write(self) -> None:
        frame, told = self._frame, self.reports
        assert frame is not None
        if self._row < 0:
            self._tell_mission(0)
        self._row += 1
        n, robots = len(frame.bodies), self.robots
        self._seen |= set(robots)
        positions = np.array([body.position for body in frame.bodies])
        near = graph.distances(positions) <= self.mission.comm_range

        def each(value: Callable[[Report], Any]) -> list[Any]:
            return [value(told[robot]) if robot in robots else None for robot in range(n)]

        silent = [DEAD if robot in self._seen else ASLEEP for robot in range(n)]
        start = Origin.START.value if self._row == 0 else Origin.HOLD.value
        self._sink.write(
            State(
                round=self._row,
                positions=positions.tolist(),
                goals=[None if goal is None else list(goal) for goal in each(lambda r: r.goal)],
                slots=each(lambda r: r.slot),
                plan_ids=each(lambda r: r.plan_id),
                influence=[0.0 if k is None else k / n for k in each(lambda r: r.neighbors)],
                waypoints=[None if x is None else list(x) for x in each(lambda r: r.waypoint)],
                origins=[start if origin is None else origin for origin in each(lambda r: r.origin)],
                phases=[phase or silent[robot] for robot, phase in enumerate(each(lambda r: r.phase))],
            )
        )
        error = self._residual()
        row = metrics_row(
            self._row,
            error=None if error is None else (error, None),
            separation=(metrics.min_separation(positions), self._row_closest),
            plan_ids=[told[robot].plan_id for robot in robots],
            slots=[told[robot].slot for robot in robots],
            at_goal=metrics.robots_at_goal(list(self._distances().values()), self.mission.spacing),
            connected=graph.is_connected(near[np.ix_(robots, robots)]) if robots else False,
            calls=(self.figures.calls, self.figures.tokens, None),
            traffic=(
                sum(report.sent for report in told.values()),
                sum(report.bytes for report in told.values()),
                sum((Counter(report.rejected) for report in told.values()), Counter[str]()),
            ),
        )
        self._sink.write(row)
        self._row_closest = float("inf")
        self._sink.write(RoundEnd(round=self._row))
        if self._on_row is not None:
            self._on_row(
                TrialProgress(
                    round=self._row,
                    rounds=0,
                    at_goal=row.robots_at_goal,
                    n_robots=len(robots),
                    plans_in_use=row.plans_in_use,
                    distinct_goals=row.distinct_goals,
                    error=error,
                    model_calls=row.model_calls,
                    tokens=row.tokens,
                    cost_usd=None,
                )
            )
