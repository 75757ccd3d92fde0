"""Sums of robots' reports, for observers. A robot may report anything: sums and memory stay within bounds."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Sequence
from itertools import chain

from llm_flock.arrays import Point
from llm_flock.bounds import MAX_INTEGER, MAX_WORD
from llm_flock.errors import InputError, MessageError
from llm_flock.plan import Plan
from llm_flock_swarm._network.wire import RobotReport
from llm_flock_swarm._zenoh import Allowance

MAX_PLANS = 256  # most plans of which one robot tells the places, or the supplier: far more than an honest one knows
RECORDED = 512 * 1024  # events and calls of each robot that are taken [bytes/s]: records fit on disks
MAX_LATENCIES = 16_384  # latest latencies of each robot that are kept


def bounded(count: int) -> int:
    """A sum as far as records hold it."""
    return min(count, MAX_INTEGER)


class SelfReports:
    """Sums over all reports of a swarm, and the plans in them; `models` names the model of each robot."""

    def __init__(self, models: Sequence[str]) -> None:
        self.calls = self.calls_failed = self.tokens = 0
        self.breakers_opened: set[int] = set()
        self.places: dict[str, tuple[Point, ...]] = {}
        self._models = models
        self._latencies_s: dict[int, deque[float]] = {}
        self._suppliers: dict[int, dict[str, str]] = {}
        self._told = Counter[int]()
        self._allowances: dict[int, Allowance] = {}

    def has_room(self, robot: int, report: RobotReport, now: float) -> bool:
        """Whether what a report adds to the record is within the robot's share at this time [s]; if so, it counts."""
        size = sum(len(entry.encoded()) for entry in (*report.happened, *report.calls))
        return not size or self._allowances.setdefault(robot, Allowance(RECORDED)).spend(now, size)

    def take(self, robot: int, report: RobotReport) -> None:
        if report.breakers:
            self.breakers_opened.add(robot)
        supplied = self._suppliers.setdefault(robot, {})
        for event in report.happened:
            plan_id = event.detail.get("plan")
            if event.kind != "proposed" or not isinstance(plan_id, str) or len(plan_id) > MAX_WORD:
                continue
            if len(supplied) < MAX_PLANS:
                supplied[plan_id] = self._models[robot] if event.detail.get("by") == "model" else "geometry"
        for call in report.calls:
            self.calls += 1
            self.calls_failed += call.error is not None
            self.tokens = bounded(self.tokens + call.usage.input + call.usage.output)
        self._latencies_s.setdefault(robot, deque(maxlen=MAX_LATENCIES)).extend(report.latencies_s)

    def take_places(self, robot: int, plan_id: str, plan: Plan) -> bool:
        """Keep the places of a plan, whose digest has been checked; whether they are news."""
        if plan_id in self.places or self._told[robot] >= MAX_PLANS:
            return False
        self._told[robot] += 1
        try:
            self.places[plan_id] = plan.points
        except InputError as error:
            raise MessageError("malformed", f"a plan that cannot be drawn: {error}") from None
        return True

    @property
    def latencies_s(self) -> list[float]:
        """Latest one-way latencies of beacons, of all robots [s]."""
        return [*chain.from_iterable(self._latencies_s.values())]

    def supplier(self, plan_id: str, proposer: int) -> str | None:
        """The model that made a robot's plan, or geometry; None if the robot has not said so."""
        return self._suppliers.get(proposer, {}).get(plan_id)


def sent(reports: Iterable[RobotReport]) -> tuple[int, int]:
    told = list(reports)
    return bounded(sum(report.sent for report in told)), bounded(sum(report.bytes for report in told))


def rejected(reports: Iterable[RobotReport]) -> dict[str, int]:
    counts = sum((Counter(report.rejected) for report in reports), Counter[str]())
    return {reason: bounded(count) for reason, count in counts.items()}
