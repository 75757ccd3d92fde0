"""One run in memory, round by round: what a page is shown of it. A finished record and a live run look the same."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

from llm_flock.record.schema import (
    DEAD,
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
from llm_flock.viewer.happenings import lane_of_call, lane_of_event
from llm_flock.viz.style import plan_look

DECIMALS = 3
FIGURES = (
    "procrustes_mean",
    "plans_in_use",
    "distinct_goals",
    "robots_at_goal",
    "segment_separation",
    "model_calls",
    "cost_usd",
)
"""What the plots show, by its name in the record."""

ROUTINE = frozenset({"preflight", "take_off", "aloft", "clipped", "landing", "landed"})
"""What happens to every flight."""

Point2 = list[float]


class Reel:
    """Rounds of one run, each shown only when it is complete.

    It takes what a record takes, from a thread of its own if need be: everything is only ever appended, and `rounds`
    is raised last.

    Args:
        key: names the run in addresses of pages.
        title: what people read.
        live: whether the run goes on while it is watched; of another one, no more is open than its reading.
    """

    def __init__(self, key: str, title: str, *, live: bool = True) -> None:
        self.key = key
        self.title = title
        self.live = live
        self.open = True
        self.failure: str | None = None
        self.info: RunInfo | None = None
        self.missions: list[MissionInfo] = []
        self.plans: list[PlanInfo] = []
        self.result: Mapping[str, Any] | None = None
        self.states: list[State] = []
        self.rows: list[MetricsRow] = []
        self.rounds = -1
        self._events: defaultdict[int, list[ProtocolEvent]] = defaultdict(list)
        self._calls: defaultdict[tuple[int, int], list[LlmEntry]] = defaultdict(list)
        self._marks: defaultdict[int, Counter[str]] = defaultdict(Counter)
        self._number: dict[str, int] = {}
        self._turns: defaultdict[tuple[int, str], list[tuple[int, int | None]]] = defaultdict(list)

    # ---------------------------------------------------------------- what comes in

    def write(self, entry: Entry) -> None:
        """Take an entry of a record; `RoundEnd` makes its round visible."""
        match entry:
            case RunInfo():
                self.info = entry
            case MissionInfo():
                self.missions.append(entry)
            case PlanInfo():
                self.plans.append(entry)
                self._number.setdefault(entry.plan_id, len(self._number))
            case ProtocolEvent():
                self._event(entry)
            case LlmEntry():
                self._calls[entry.round, entry.robot].append(entry)
                self._mark(entry.round, lane_of_call(entry))
            case State():
                for plan_id in entry.plan_ids:
                    if plan_id is not None:
                        self._number.setdefault(plan_id, len(self._number))
                self.states.append(entry)
            case MetricsRow():
                self.rows.append(entry)
            case FlightEvent():
                self._flight(entry)
            case RoundEnd():
                self.rounds = entry.round
            case SummaryMessage():
                self.result = entry.result
            case _:
                pass  # bodies are not shown between rounds

    def _event(self, event: ProtocolEvent) -> None:
        self._events[event.round].append(event)
        self._mark(event.round, lane_of_event(event))
        if event.kind in ("proposed", "adopted"):
            self._turns[event.robot, str(event.detail.get("plan"))].append((event.round, event.detail.get("from")))

    def _flight(self, event: FlightEvent) -> None:
        if event.kind not in ROUTINE:
            self._mark(event.round, "faults")
        if event.robot is not None:
            shown = ProtocolEvent(
                round=event.round, comm_round=None, robot=event.robot, kind=event.kind, detail=event.detail
            )
            self._events[event.round].append(shown)

    def _mark(self, number: int, track: str | None) -> None:
        if track is not None:
            self._marks[number][track] += 1

    def close(self) -> None:
        """No more is to come."""
        self.open = False

    # ---------------------------------------------------------------- what is shown

    @property
    def ready(self) -> bool:
        """Whether there is anything to show."""
        return self.rounds >= 0 and bool(self.missions)

    @property
    def n_robots(self) -> int:
        """Team size N."""
        return int(self.missions[0].mission["n_robots"])

    @property
    def simulated(self) -> bool:
        """Whether any language model was a simulated stand-in."""
        return self.info is not None and self.info.simulated

    @property
    def in_words(self) -> str:
        """What is flown: shape, N, rules, model and seed; nothing before it is known."""
        if self.info is None or not self.missions:
            return ""
        protocol, model = self.info.config.get("protocol", {}), self.info.config.get("model", {})
        rules = " + ".join(str(protocol[key]) for key in ("consensus", "assignment") if protocol.get(key))
        fields = self.missions[0].mission
        parts = (f"{fields['shape']} of {self.n_robots}", rules, model.get("model", ""), f"seed {self.info.seed}")
        return " · ".join(str(part) for part in parts if part)

    def mission_at(self, number: int) -> MissionInfo:
        """The mission in force in a round."""
        given = list(self.missions)
        return next((info for info in reversed(given) if info.round <= number), given[0])

    def events(self, number: int) -> Sequence[ProtocolEvent]:
        """What happened in a round, in the order of its telling."""
        return tuple(self._events.get(number, ()))

    def calls(self, number: int, robot: int) -> Sequence[LlmEntry]:
        """What a robot's model was asked in a round."""
        return tuple(self._calls.get((number, robot), ()))

    def turn(self, robot: int, plan_id: str, until: int) -> tuple[int, int | None] | None:
        """When a robot last turned to a plan, and whose it was before: None for its own. None if it never did."""
        turns = self._turns.get((robot, plan_id), ())
        return next((turn for turn in reversed(turns) if turn[0] <= until), None)

    def last_call(self, number: int, robot: int) -> int | None:
        """The last round, not after the given one, in which the robot's model was asked."""
        return next((k for k in range(number, -1, -1) if (k, robot) in self._calls), None)

    def plan_name(self, plan_id: str | None) -> str:
        """The letters that stand for a plan; a dash for none."""
        return "-" if plan_id is None else plan_look(self._number.get(plan_id, 0)).name

    def about(self) -> dict[str, Any]:
        """All that a page needs before the first round."""
        fields = self.missions[0].mission
        return {
            "key": self.key,
            "title": self.title,
            "live": self.live,
            "simulated": self.simulated,
            "robots": self.n_robots,
            "safe_distance": fields["safe_distance"],
            "comm_range": fields["comm_range"],
            "max_step": fields["max_step"],
            "spacing": fields["spacing"],
            "arena": [list(corner)[:2] for corner in fields["arena"]],
            "obstacles": [_flat_obstacle(obstacle) for obstacle in fields.get("obstacles", ())],
        }

    def news(self, rounds: int, plans: int, missions: int) -> dict[str, Any]:
        """What came after so many rounds, plans and missions, but the robots themselves.

        Args:
            rounds: number of rounds whose figures are known, the start counted.
            plans: number of known plans.
            missions: number of known missions.
        """
        last = self.rounds
        rows = self.rows[rounds : last + 1]
        return {
            "last": last,
            "open": self.open,
            "failure": self.failure,
            "plans": [_look(number) for number in range(plans, len(self._number))],
            "missions": [
                {"round": m.round, "text": f"{m.mission['shape']} of {m.mission['n_robots']}"}
                for m in self.missions[missions:]
            ],
            "figures": {name: [_short(getattr(row, name)) for row in rows] for name in FIGURES},
            "marks": {str(k): dict(self._marks[k]) for k in range(rounds, last + 1) if k in self._marks},
        }

    def frames(self, first: int, count: int) -> list[dict[str, Any]]:
        """The robots in some rounds; fewer where the run has fewer."""
        return [self._frame(self.states[k]) for k in range(max(0, first), min(first + count, self.rounds + 1))]

    def _frame(self, state: State) -> dict[str, Any]:
        return {
            "r": state.round,
            "x": [_flat(row) for row in state.positions],
            "g": [None if row is None else _flat(row) for row in state.goals],
            "s": state.slots,
            "p": [-1 if plan_id is None else self._number[plan_id] for plan_id in state.plan_ids],
            "i": [round(share, 2) for share in state.influence],
            "d": [robot for robot, phase in enumerate(state.phases) if phase == DEAD],
            "z": [robot for robot, phase in enumerate(state.phases) if phase == "asleep"],
            "h": [robot for robot, origin in enumerate(state.origins) if origin in ("shield", "detour", "fallback")],
        }


def _look(number: int) -> dict[str, str]:
    look = plan_look(number)
    return {"name": look.name, "fill": look.fill, "line": look.line, "ink": look.ink, "rim": look.rim}


def _flat(row: Sequence[float]) -> Point2:
    """Seen from above."""
    return [round(row[0], DECIMALS), round(row[1], DECIMALS)]


def _flat_obstacle(obstacle: Mapping[str, Any]) -> dict[str, Any]:
    return dict(obstacle)


def _short(value: float | None) -> float | None:
    return None if value is None else round(value, 6)
