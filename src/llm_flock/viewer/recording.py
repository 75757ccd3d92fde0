"""One run in memory, round by round. A finished record, a growing one and a live swarm look the same."""

from __future__ import annotations

import logging
import math
import os
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from llm_flock.printable import printable
from llm_flock.record.schema import (
    SILENT,
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
from llm_flock.record.words import protocol_text
from llm_flock.viewer.canvases import TOO_CLOSE
from llm_flock.viewer.events import breaker_text, track_of_event
from llm_flock.viz.style import plan_look

logger = logging.getLogger(__name__)

ROUTINE = frozenset({"preflight", "take_off", "aloft", "clipped", "landing", "landed"})
"""Flight events that belong to every flight."""


ROUNDING = 1e-6
"""A pair that is nearer by less than this keeps its distance [units]."""


def close_pairs(positions: Sequence[Sequence[float]], safe: float) -> int:
    """Number of pairs nearer than the safe distance [units]; boxes of that width make a thousand robots quick."""
    boxes: defaultdict[tuple[int, int], list[Sequence[float]]] = defaultdict(list)
    found = 0
    for row in positions:
        column, line = math.floor(row[0] / safe), math.floor(row[1] / safe)
        for i in (column - 1, column, column + 1):
            for j in (line - 1, line, line + 1):
                found += sum(math.dist(row, other) < safe - ROUNDING for other in boxes.get((i, j), ()))
        boxes[column, line].append(row)
    return found


def box(rows: Sequence[Sequence[float] | None]) -> list[float]:
    """Lower left and upper right of some points, seen from above [units]; None stands for no point."""
    seen = [row for row in rows if row is not None]
    columns, lines = [row[0] for row in seen], [row[1] for row in seen]
    return [min(columns), min(lines), max(columns), max(lines)]


def version_of(found: os.stat_result) -> tuple[int, ...]:
    """Numbers that differ between two files, and between a file and what it is after it was written to."""
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


class PlanOrigin(NamedTuple):
    """One step on the way of a plan to a robot: `robot` has it from `round` on, from `source`.

    The first one proposed it, so its source is None; then `by` says who made the plan: `model` or `geometry`.
    """

    round: int
    robot: int
    source: int | None
    by: str = "model"


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


class HeardClaim(NamedTuple):
    """What a robot within radio range claims; a rival claims the same slot of the same plan as the listener.

    `influence` is the share of the team that hears it, `distance` its distance from the listener [units].
    """

    robot: int
    plan: str
    slot: int | None
    influence: float
    distance: float
    rival: bool


class Recording:
    """The rounds of one run; each becomes visible when it is complete. A sink for record entries.

    Another thread may write: entries are only ever appended, and `rounds` is raised last.

    Attributes:
        key: names the run in addresses of pages.
        path: its record, None without one.
        live: whether the run goes on while it is watched.
        open: whether more may come.
        failure: why there is nothing (more) to show.
        version: of the file as it was read; see `version_of`.
        rounds: last complete round, -1 before the start.
        plan_numbers: number of each plan, in the order in which plans were first seen.
        plans: the places of each plan, and who proposed it.
        marks: number of marks on each timeline track, by round.
        accused: robots that others accused of lying, each with the last reason.
        died: the round in which each robot died last.
        disturbed: last round in which a robot died or joined, 0 before any did.
        tallies: what became of the calls of each robot's model.
        steer: what can be ordered of it now, for runs that take orders.
        extent: lower left and upper right of where robots and goals have been, seen from above [units].
    """

    def __init__(self, key: str, title: str, path: Path | None, *, live: bool) -> None:
        self.key = key
        self.title = title
        self.path = path
        self.live = live
        self.open = True
        self.failure: str | None = None
        self.version: tuple[int, ...] | None = None
        self.info: RunInfo | None = None
        self.missions: list[MissionInfo] = []
        self.result: Mapping[str, Any] | None = None
        self.states: list[State] = []
        self.rows: list[MetricsRow] = []
        self.rounds = -1
        self.plan_numbers: dict[str, int] = {}
        self.plans: dict[str, PlanInfo] = {}
        self.marks: defaultdict[int, Counter[str]] = defaultdict(Counter)
        self.accused: dict[int, str] = {}
        self.died: dict[int, int] = {}
        self.disturbed = 0
        self.tallies: defaultdict[int, CallCounts] = defaultdict(CallCounts)
        self.extent: list[float] = []
        self.steer: Callable[[], dict[str, Any]] | None = None
        self._loss: float | None = None
        self._events: defaultdict[int, list[ProtocolEvent]] = defaultdict(list)
        self._breakers: defaultdict[int, list[ProtocolEvent]] = defaultdict(list)
        self._calls: defaultdict[tuple[int, int], list[LlmEntry]] = defaultdict(list)
        self._origins: defaultdict[tuple[int, str], list[PlanOrigin]] = defaultdict(list)

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
                self._events[entry.round].append(entry)
                self._mark(entry.round, track_of_event(entry))
                if entry.kind == "breaker":
                    self._breakers[entry.robot].append(entry)
                    self.tallies[entry.robot].opened += entry.detail.get("state") == "open"
                if entry.kind in ("killed", "joined"):
                    self.disturbed = max(self.disturbed, entry.round)
                if entry.kind == "killed":
                    self.died[entry.robot] = entry.round
                if entry.kind == "accused" and isinstance(entry.detail.get("robot"), int):
                    self.accused[entry.detail["robot"]] = str(entry.detail.get("reason")).replace("_", " ")
                if entry.kind == "injected" and isinstance(entry.detail.get("loss"), int | float):
                    self._loss = float(entry.detail["loss"])
                if entry.kind == "fallback":
                    self.tallies[entry.robot].helped += 1
                if entry.kind in ("proposed", "adopted"):
                    by = str(entry.detail.get("by", "model"))
                    origin = PlanOrigin(entry.round, entry.robot, entry.detail.get("from"), by)
                    self._origins[entry.robot, str(entry.detail.get("plan"))].append(origin)
            case FlightEvent(round=number, robot=robot, kind=kind, detail=detail):
                if kind not in ROUTINE:
                    self._mark(number, "faults")
                if robot is not None:
                    listed = ProtocolEvent(round=number, comm_round=None, robot=robot, kind=kind, detail=detail)
                    self._events[number].append(listed)
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
                self._measure(entry.round)
                self.rounds = entry.round
            case SummaryMessage():
                self.result = entry.result
            case _:
                pass  # positions between rounds are not shown

    def _mark(self, number: int, track: str | None) -> None:
        if track is not None:
            self.marks[number][track] += 1

    def _called(self, entry: LlmEntry) -> None:
        self._calls[entry.round, entry.robot].append(entry)
        tally = self.tallies[entry.robot]
        tally.asked += 1
        tally.model = entry.model
        if entry.error is not None:
            self._mark(entry.round, "faults")
            tally.failed += 1
            tally.last = entry.error
        elif entry.rejected is not None:
            self._mark(entry.round, "retries")
            tally.refused += 1
            tally.last = entry.rejected

    def _measure(self, number: int) -> None:
        """Count the pairs that are too close, and widen the extent."""
        if not self.missions or number >= len(self.states):
            return
        state, mission = self.states[number], self.mission_at(number).mission
        safe = float(mission["safe_distance"])
        near = self.rows[number].min_separation if number < len(self.rows) else None
        if near is not None and near < safe:
            pairs = close_pairs(state.positions, safe)
            if pairs:
                self.marks[number][TOO_CLOSE] = pairs
        known = [self.extent[:2], self.extent[2:]] if self.extent else []
        self.extent = box([*known, *state.positions, *state.goals])

    def fail(self, error: Exception) -> None:
        """Show why no more comes, and log it."""
        self.failure = printable(str(error))
        logger.warning("%s", error)

    @property
    def ready(self) -> bool:
        """Whether there is anything to show."""
        return self.rounds >= 0 and bool(self.missions)

    @property
    def n_robots(self) -> int:
        """Team size N; ask only when `ready`."""
        return int(self.missions[0].mission["n_robots"])

    @property
    def simulated(self) -> bool:
        """Whether any language model was a simulated stand-in."""
        return self.info is not None and self.info.simulated

    @property
    def without_models(self) -> bool:
        """Whether geometry flew all robots, as was asked for."""
        config: Mapping[str, Any] = {} if self.info is None else self.info.config.get("model", {})
        return config.get("model") == "geometry"

    @property
    def rules(self) -> tuple[str, str]:
        """The rules of consensus and of assignment; empty where the record does not say."""
        config: Mapping[str, Any] = {} if self.info is None else self.info.config.get("protocol", {})
        return str(config.get("consensus") or ""), str(config.get("assignment") or "")

    @property
    def loss(self) -> float:
        """Share of the messages that were lost in the end, as asked for."""
        given: Mapping[str, Any] = {} if self.info is None else self.info.config.get("links", {})
        share = given.get("loss") if self._loss is None else self._loss
        return float(share) if isinstance(share, int | float) else 0.0

    @property
    def description(self) -> str:
        """Shape, N, protocol, model and seed; empty while they are not known."""
        if self.info is None or not self.missions:
            return ""
        config, shape = self.info.config, self.missions[0].mission["shape"]
        model = config.get("model", {}).get("model", "")
        parts = (f"{shape} of {self.n_robots}", protocol_text(config), model, f"seed {self.info.seed}")
        return printable(" · ".join(str(part) for part in parts if part))

    def mission_at(self, number: int) -> MissionInfo:
        """The mission in force in a round."""
        given = list(self.missions)
        return next((info for info in reversed(given) if info.round <= number), given[0])

    def events(self, number: int) -> Sequence[ProtocolEvent]:
        """The events of a round, in the order of the record."""
        return tuple(self._events.get(number, ()))

    def calls(self, number: int, robot: int) -> Sequence[LlmEntry]:
        """The calls of a robot's model in a round."""
        return tuple(self._calls.get((number, robot), ()))

    def last_call(self, number: int, robot: int) -> int | None:
        """The last round, up to the given one, in which the robot's model was called."""
        return next((k for k in range(number, -1, -1) if (k, robot) in self._calls), None)

    def breakers(self, number: int, robot: int) -> list[str]:
        """What a robot's open circuit breakers have seen by a round, a sentence each; empty while all are closed."""
        newest = {event.detail.get("question"): event for event in self._breakers[robot] if event.round <= number}
        return [breaker_text(event) for event in newest.values() if event.detail.get("state") == "open"]

    def plan_name(self, plan_id: str | None) -> str:
        """The letters that stand for a plan; a dash for none."""
        return "-" if plan_id is None else plan_look(self.plan_numbers.get(plan_id, 0)).name

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

    def claims_heard(self, robot: int, number: int) -> list[HeardClaim]:
        """The claims within a robot's radio range in a round, its own first, then the nearest."""
        state = self.states[number]
        reach = float(self.mission_at(number).mission["comm_range"])
        own = state.plan_ids[robot], state.slots[robot]
        found = [
            HeardClaim(
                robot=other,
                plan=self.plan_name(state.plan_ids[other]),
                slot=state.slots[other],
                influence=state.influence[other],
                distance=math.dist(state.positions[robot], state.positions[other]),
                rival=other != robot and own[1] is not None and own == (state.plan_ids[other], state.slots[other]),
            )
            for other in range(len(state.positions))
            if other == robot or state.phases[other] not in SILENT
        ]
        return sorted((c for c in found if c.distance <= reach), key=lambda c: (c.robot != robot, c.distance))
