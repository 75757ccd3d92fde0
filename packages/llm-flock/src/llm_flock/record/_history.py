"""One run in memory by rounds and robots, also while it still grows: what pages and the diagnosis ask of it.

Needs no numerical library: a first page waits for it.
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


class PlanOrigin(NamedTuple):
    """One step on the way of a plan to a robot, which has it from `round` on; the first step has no source."""

    round: int
    robot: int
    source: int | None
    by: str = "model"  # who made the plan, where it was proposed: `model` or `geometry`


@dataclass(slots=True)
class CallCounts:
    """What became of the calls of one robot's model by now; `last` is the newest reason why an answer was no use."""

    model: str = ""
    asked: int = 0
    refused: int = 0
    failed: int = 0
    helped: int = 0
    opened: int = 0
    last: str = ""

    @property
    def unusable(self) -> int:
        """Calls without a usable answer."""
        return self.refused + self.failed

    @property
    def trouble(self) -> int:
        """How much there is to look at; an open circuit breaker counts for many refusals."""
        return self.unusable + self.helped + 5 * self.opened

    @property
    def words(self) -> str:
        """What there is, in words."""
        parts = [
            (self.refused, "answer was refused", "answers were refused"),
            (self.failed, "call failed", "calls failed"),
            (self.helped, "time helped", "times helped"),
        ]
        told = [f"{count} {one if count == 1 else more}" for count, one, more in parts if count]
        return ", ".join([*told, "its circuit breaker opened"] if self.opened else told)


class RunHistory:
    """A sink for the entries of one run; each round becomes visible when it is complete.

    Another thread may write: entries are only ever appended, and `rounds` is raised last.
    """

    def __init__(self) -> None:
        self.info: RunInfo | None = None
        self.missions: list[MissionInfo] = []
        self.result: Mapping[str, Any] | None = None
        self.states: list[State] = []
        self.rows: list[MetricsRow] = []
        self.rounds = -1  # the last complete one
        self.plan_numbers: dict[str, int] = {}  # in the order in which plans were first seen
        self.plans: dict[str, PlanInfo] = {}
        self.events: defaultdict[int, list[ProtocolEvent]] = defaultdict(list)  # by round
        self.calls: defaultdict[tuple[int, int], list[LlmEntry]] = defaultdict(list)  # by round and robot
        self.accused: dict[int, str] = {}  # robots that others accused of lying, each with the last reason
        self.died: dict[int, int] = {}  # the round in which each robot died last
        self.disturbed = 0  # last round in which a robot died or joined
        self.tallies: defaultdict[int, CallCounts] = defaultdict(CallCounts)
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
                self._happened(entry)
            case FlightEvent(round=number, robot=robot, kind=kind, detail=detail) if robot is not None:
                listed = ProtocolEvent(round=number, comm_round=None, robot=robot, kind=kind, detail=detail)
                self.events[number].append(listed)
            case LlmEntry():
                self._called(entry)
            case State():
                for plan_id in entry.plan_ids:
                    if plan_id is not None:
                        self.plan_numbers.setdefault(plan_id, len(self.plan_numbers))
                self.states.append(entry)
            case MetricsRow():
                self.rows.append(entry)
            case RoundEnd():
                self.rounds = entry.round
            case SummaryMessage():
                self.result = entry.result
            case _:
                pass  # positions between rounds, and what concerns a flight as a whole

    def _happened(self, event: ProtocolEvent) -> None:
        robot, detail = event.robot, event.detail
        match event.kind:
            case "breaker":
                self.tallies[robot].opened += detail.get("state") == "open"
            case "fallback":
                self.tallies[robot].helped += 1
            case "killed" | "joined":
                self.disturbed = max(self.disturbed, event.round)
                if event.kind == "killed":
                    self.died[robot] = event.round
            case "accused" if isinstance(detail.get("robot"), int):
                self.accused[detail["robot"]] = str(detail.get("reason")).replace("_", " ")
            case "injected" if isinstance(detail.get("loss"), int | float):
                self._loss = float(detail["loss"])
            case "proposed" | "adopted":
                origin = PlanOrigin(event.round, robot, detail.get("from"), str(detail.get("by", "model")))
                self._origins[robot, str(detail.get("plan"))].append(origin)
            case _:
                pass

    def _called(self, entry: LlmEntry) -> None:
        self.calls[entry.round, entry.robot].append(entry)
        tally = self.tallies[entry.robot]
        tally.asked += 1
        tally.model = entry.model
        if entry.error is not None:
            tally.failed += 1
            tally.last = entry.error
        elif entry.rejected is not None:
            tally.refused += 1
            tally.last = entry.rejected

    @property
    def n_robots(self) -> int:
        """Team size N; ask only when there is a mission."""
        return int(self.missions[0].mission["n_robots"])

    @property
    def rules(self) -> tuple[str, str]:
        """The rules of consensus and of assignment; empty where the record does not say."""
        config = self._config("protocol")
        return str(config.get("consensus") or ""), str(config.get("assignment") or "")

    @property
    def without_models(self) -> bool:
        """Whether geometry flew all robots, as was asked for."""
        return self._config("model").get("model") == "geometry"

    @property
    def loss(self) -> float:
        """Share of the messages that were lost in the end, as asked for."""
        share = self._config("links").get("loss") if self._loss is None else self._loss
        return float(share) if isinstance(share, int | float) else 0.0

    def _config(self, section: str) -> Mapping[str, Any]:
        return {} if self.info is None else self.info.config.get(section, {})

    def mission_at(self, number: int) -> MissionInfo:
        """The mission in force in a round."""
        given = list(self.missions)
        return next((info for info in reversed(given) if info.round <= number), given[0])

    def plan_name(self, plan_id: str | None) -> str:
        """The letters that stand for a plan; a dash for none."""
        return "-" if plan_id is None else letters(self.plan_numbers.get(plan_id, 0))

    def provenance(self, robot: int, number: int) -> list[PlanOrigin]:
        """How the plan that a robot follows in a round came to it, from the proposal on; empty without a plan."""
        plan_id = self.states[number].plan_ids[robot]
        found: list[PlanOrigin] = []
        holder: int | None = robot
        while plan_id is not None and holder is not None and len(found) <= self.n_robots:
            origins = self._origins.get((holder, plan_id), ())
            origin = next((one for one in reversed(origins) if one.round <= number), None)
            if origin is None:
                break
            found.append(origin)
            number, holder = origin.round, origin.source
        return found[::-1]

    def made_by_geometry(self, plan_id: str) -> bool:
        """Whether geometry, and no model, made a plan."""
        origins = self._origins.get((self.plans[plan_id].proposer, plan_id), ()) if plan_id in self.plans else ()
        return bool(origins) and origins[0].by == "geometry"

    def last_calls(self, robot: int, kind: str, number: int) -> tuple[LlmEntry, ...]:
        """The last call of a kind of a robot's model up to a round, and its retries: a path is flown without calls."""
        for k in range(number, -1, -1):
            found = tuple(entry for entry in self.calls.get((k, robot), ()) if entry.kind == kind)
            if found:
                return found
        return ()
