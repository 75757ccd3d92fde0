"""One run in memory, by rounds and robots, also while it still grows. Pages and the diagnosis read it.

Needs no numerical library, so that a first page loads quickly.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

from llm_flock.record._schema import (
    Entry,
    FlightEvent,
    LlmEntry,
    MetricsRow,
    MissionInfo,
    PlanInfo,
    ProtocolEvent,
    RoundEnd,
    RunInfo,
    State,
    SummaryMessage,
)
from llm_flock.record._words import letters

HELD_ROUNDS = 3  # rounds in order after which a team has formed, as in `llm_flock.metrics`


class PlanOrigin(NamedTuple):
    """One hop of a plan: `robot` received it from `source` in `round`. The proposal itself has no source."""

    round: int
    robot: int
    source: int | None
    by: str = "model"  # maker of the plan in a proposal: `model` or `geometry`


@dataclass(slots=True)
class CallCounts:
    """Outcomes of one robot's model calls so far; `last` is the latest reason for a rejection or failure."""

    model: str = ""
    asked: int = 0
    rejected: int = 0
    failed: int = 0
    fallbacks: int = 0
    breaker_openings: int = 0
    last: str = ""

    @property
    def unusable(self) -> int:
        """Calls without a usable answer."""
        return self.rejected + self.failed


class RunHistory:
    """A sink for the entries of one run. Each round becomes visible when it is complete.

    Another thread may write: entries are only ever appended, and `last_round` is raised last.
    """

    def __init__(self) -> None:
        self.info: RunInfo | None = None
        self.missions: list[MissionInfo] = []
        self.result: Mapping[str, Any] | None = None
        self.states: list[State] = []
        self.rows: list[MetricsRow] = []
        self.last_round = -1  # that is complete
        self.plan_numbers: dict[str, int] = {}  # in the order in which plans were first seen
        self.plans: dict[str, PlanInfo] = {}
        self.events: defaultdict[int, list[ProtocolEvent]] = defaultdict(list)  # by round
        self.calls: defaultdict[tuple[int, int], list[LlmEntry]] = defaultdict(list)  # by round and robot
        self.accused: dict[int, str] = {}  # robots that others accused of lying, each with the last reason
        self.death_rounds: dict[int, int] = {}  # in which each robot died last
        self.formations: list[tuple[int, int]] = []  # first and last round of each time in which the team stood formed
        self.call_counts: defaultdict[int, CallCounts] = defaultdict(CallCounts)
        self._loss: float | None = None
        self._origins: defaultdict[tuple[int, str], list[PlanOrigin]] = defaultdict(list)

    @classmethod
    def of(cls, entries: Iterable[Entry]) -> Self:
        """The history of a run that is over."""
        history = cls()
        for entry in entries:
            history.write(entry)
        return history

    def write(self, entry: Entry) -> None:
        """Take an entry of a record; `RoundEnd` makes its round visible."""
        match entry:
            case RunInfo():
                self.info = entry
            case MissionInfo():
                self.missions.append(entry)
            case PlanInfo():
                self.plan_numbers.setdefault(entry.plan_id, len(self.plan_numbers))
                self.plans.setdefault(entry.plan_id, entry)
            case ProtocolEvent():
                self.events[entry.round].append(entry)
                self._take_event(entry)
            case FlightEvent(round=number, robot=robot, kind=kind, detail=detail) if robot is not None:
                listed = ProtocolEvent(round=number, comm_round=None, robot=robot, kind=kind, detail=detail)
                self.events[number].append(listed)
            case LlmEntry():
                self._take_call(entry)
            case State():
                for plan_id in entry.plan_ids:
                    if plan_id is not None:
                        self.plan_numbers.setdefault(plan_id, len(self.plan_numbers))
                self.states.append(entry)
            case MetricsRow():
                self.rows.append(entry)
                self._take_row(entry)
            case RoundEnd():
                self.last_round = entry.round
            case SummaryMessage():
                self.result = entry.result
            case _:
                pass  # positions between rounds, and events of a flight as a whole

    def _take_row(self, row: MetricsRow) -> None:
        since = row.in_order_since
        if since is None or row.round - since + 1 < HELD_ROUNDS:
            return
        if self.formations and self.formations[-1][0] == since:
            self.formations[-1] = since, row.round
        else:
            self.formations.append((since, row.round))

    def _take_event(self, event: ProtocolEvent) -> None:
        robot, detail = event.robot, event.detail
        match event.kind:
            case "breaker":
                self.call_counts[robot].breaker_openings += detail.get("state") == "open"
            case "fallback":
                self.call_counts[robot].fallbacks += 1
            case "killed":
                self.death_rounds[robot] = event.round
            case "accused" if isinstance(detail.get("robot"), int):
                self.accused[detail["robot"]] = str(detail.get("reason")).replace("_", " ")
            case "injected" if isinstance(detail.get("loss"), int | float):
                self._loss = float(detail["loss"])
            case "proposed" | "adopted":
                origin = PlanOrigin(event.round, robot, detail.get("from"), str(detail.get("by", "model")))
                self._origins[robot, str(detail.get("plan"))].append(origin)
            case _:
                pass

    def _take_call(self, entry: LlmEntry) -> None:
        self.calls[entry.round, entry.robot].append(entry)
        counts = self.call_counts[entry.robot]
        counts.asked += 1
        counts.model = entry.model
        if entry.error is not None:
            counts.failed += 1
            counts.last = entry.error
        elif entry.rejected is not None:
            counts.rejected += 1
            counts.last = entry.rejected

    @property
    def n_robots(self) -> int:
        """Team size N. Call only when there is a mission."""
        return int(self.missions[0].mission["n_robots"])

    @property
    def rules(self) -> tuple[str, str]:
        """The rules of consensus and of assignment; empty if the record has none."""
        config = self._config("protocol")
        return str(config.get("consensus") or ""), str(config.get("assignment") or "")

    @property
    def without_models(self) -> bool:
        """Whether the configuration lets geometry fly all robots."""
        return self._config("model").get("model") == "geometry"

    @property
    def loss(self) -> float:
        """Share of lost messages, as configured or last injected."""
        share = self._config("links").get("loss") if self._loss is None else self._loss
        return float(share) if isinstance(share, int | float) else 0.0

    def _config(self, section: str) -> Mapping[str, Any]:
        return {} if self.info is None else self.info.config.get(section, {})

    def mission_at(self, number: int) -> MissionInfo:
        """The mission in force in a round."""
        return next((info for info in reversed(self.missions) if info.round <= number), self.missions[0])

    def plan_name(self, plan_id: str | None) -> str:
        """The letters that stand for a plan; a dash for none."""
        return "-" if plan_id is None else letters(self.plan_numbers.get(plan_id, 0))

    def provenance(self, robot: int, number: int) -> list[PlanOrigin]:
        """The hops by which a robot's plan in a round came to it, from the proposal on; empty without a plan."""
        plan_id = self.states[number].plan_ids[robot]
        hops: list[PlanOrigin] = []
        holder: int | None = robot
        while plan_id is not None and holder is not None and len(hops) <= self.n_robots:
            origins = self._origins.get((holder, plan_id), ())
            origin = next((one for one in reversed(origins) if one.round <= number), None)
            if origin is None:
                break
            hops.append(origin)
            number, holder = origin.round, origin.source
        return hops[::-1]

    def made_by_geometry(self, plan_id: str) -> bool:
        """Whether geometry, and no model, made a plan."""
        origins = self._origins.get((self.plans[plan_id].proposer, plan_id), ()) if plan_id in self.plans else ()
        return bool(origins) and origins[0].by == "geometry"

    def last_calls(self, robot: int, kind: str, number: int) -> tuple[LlmEntry, ...]:
        """The last call of a kind of a robot's model up to a round, with its retries."""
        rounds = (self.calls.get((k, robot), ()) for k in range(number, -1, -1))
        return next(filter(None, (tuple(entry for entry in calls if entry.kind == kind) for calls in rounds)), ())
