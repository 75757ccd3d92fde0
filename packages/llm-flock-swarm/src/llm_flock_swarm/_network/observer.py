"""Turns world states and robot reports into measurements and a record, and decides whether the team has formed.

An observer only listens, and believes a robot only about itself. Positions come from the sensors. A mission needs the
operator's signature if the team has keys. Places are those that a plan's digest names, and a place counts as blocked
once more robots report it than may be lying.
"""

from __future__ import annotations

import logging
import math
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import ValidationError

from llm_flock import graph, metrics
from llm_flock.arrays import Point, Points
from llm_flock.errors import FlockError, MessageError
from llm_flock.events import Origin
from llm_flock.llm import parse_models
from llm_flock.message import MissionStamp, check_plan_sent
from llm_flock.mission import Mission
from llm_flock.record import ASLEEP, DEAD, Guarded, MetricsRow, PlanInfo, RecordSink, RoundEnd, State
from llm_flock.runtime import TrialProgress, commonest, finite, fits, mission_info
from llm_flock.validation import input_error
from llm_flock_swarm._network.accusations import Judge
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.self_reports import SelfReports, rejected, sent
from llm_flock_swarm._network.wire import RobotReport, WorldState

logger = logging.getLogger(__name__)

SILENT_S = 1.0  # a robot that reports is there; it is gone once it has left and has been silent for this long [s]
MAX_UNPROVEN = 8  # accusations of one robot that prove nothing, after which none are judged: each takes time


class _FormedClock:
    """Decides since when a team has formed: from when it came in order, once it has been so for `held_s`."""

    def __init__(self, spacing: float, held_s: float) -> None:
        self.formed_s: float | None = None
        self.tracker = metrics.FormedTracker(spacing=spacing)
        self.since_row = 0  # first row of the record in which it was in order, while it is
        self._held_s = held_s
        self._since_s = math.inf
        self._checks = 0

    def update(self, now: float, row: int, **team: Any) -> None:
        """Add the state of the team at a time, before a row of the record, as `FormedTracker.update` takes it."""
        self._checks += 1
        before = self.tracker.since
        self.tracker.update(self._checks, **team)
        if self.tracker.since != before:
            self._since_s, self.since_row = now, row
        if self.tracker.left:
            self.formed_s = None
        if self.formed_s is None and self.tracker.in_order and now - self._since_s >= self._held_s:
            self.formed_s = self._since_s


class Observer:
    """Follows one swarm. Give it what arrives, and call `check` again and again.

    `signed` tells whether the operator signed a mission, and `judge` whether an accusation is proven; None in a team
    without keys, where every process is trusted and nothing can be proven. `clock` is the wall clock [s]. `ended` has
    the errors of parts that look on: see `Guarded`.
    """

    def __init__(
        self,
        config: SwarmConfig,
        sink: RecordSink,
        on_row: Callable[[TrialProgress], None] | None = None,
        *,
        signed: Callable[[MissionStamp, bytes], bool] | None = None,
        judge: Judge | None = None,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self.ended: dict[str, Exception] = {}
        self.min_separation = math.inf
        self.late_commands = 0
        self.began_s: float | None = None
        self.alive: set[int] = set()
        self.reports: dict[int, RobotReport] = {}
        self.heard_s: dict[int, float] = {}
        self.shown_to_lie: dict[int, str] = {}
        self.on_world = Guarded("view", None, self.ended)
        self._unproven = Counter[int]()
        self.said = SelfReports(parse_models(config.model.model, config.mission.n_robots))
        self._config = config
        # Robots that have to say that a place is blocked; fewer only in a team that has fewer.
        self._witnesses = config.network.liars + 1
        self._sink = Guarded("sink", sink.write, self.ended)
        self._on_row = Guarded("display", on_row, self.ended)
        self._signed, self._judge = signed, judge
        self._clock = clock
        self._left: set[int] = set()
        self._world: WorldState | None = None
        self._row = -1
        self._row_due = 0.0
        self._row_closest = math.inf
        self._counter = 0
        self._seen: set[int] = set()
        self._missions = 0
        self._set_mission(config.mission)

    def _set_mission(self, mission: Mission) -> None:
        self.mission = mission
        turns = mission.turn is None
        self._target = None if mission.ideal is None else metrics.ShapeTarget(np.array(mission.ideal), turns=turns)
        self._restart()

    def comes_or_goes(self, robot: int, alive: bool) -> None:
        """Take note that a process came, or left the network; one that goes on to report has not left."""
        if not 0 <= robot < self.mission.n_robots:
            return
        if not alive:
            self._left.add(robot)
            return
        self._left.discard(robot)
        if robot not in self.alive:
            self.alive.add(robot)
            self._restart()

    def _take_leave(self, now: float) -> None:
        """Count robots as gone that have left and are silent."""
        for robot in list(self._left):
            if now - self.heard_s.get(robot, -math.inf) >= SILENT_S:
                self._left.discard(robot)
                self.alive.discard(robot)
                self._restart()

    def _restart(self) -> None:
        self._formed = _FormedClock(self.mission.spacing, metrics.HELD_ROUNDS * self._config.network.step_s)

    @property
    def in_order(self) -> bool:
        return self._formed.tracker.in_order

    @property
    def formed_s(self) -> float | None:
        """When the team came in order and stayed so [s]; None if it has not formed."""
        return self._formed.formed_s

    @property
    def _current_row(self) -> int:
        return max(self._row, 0)

    def world(self, state: WorldState) -> None:
        """Take a reading of the sensors; one of another team is dropped."""
        if [len(body.position) for body in state.bodies] != [self.mission.dim] * self.mission.n_robots:
            return
        self._world = state
        closest = math.inf if state.closest is None else state.closest
        self.min_separation = min(self.min_separation, closest)
        self.late_commands = state.late
        self._row_closest = min(self._row_closest, closest)
        self.on_world(state)

    def report(self, robot: int, report: RobotReport) -> None:
        """Take a robot's report; nothing of it is taken if no honest robot of this team reports like this."""
        if not 0 <= robot < self.mission.n_robots:
            raise MessageError("unknown_id", f"a report of member {robot}")
        now_s = self._clock()
        if not self.said.has_room(robot, report, now_s):
            raise MessageError("too_much", "more events and calls than records have room for")
        self._check_report(robot, report)
        happened = [e for e in report.happened if e.kind != "accused" or self._is_news(robot, e.detail)]
        self._take_mission(report)
        self._take_places(robot, report)
        self.reports[robot] = report
        self.heard_s[robot] = now_s
        if report.round and self.began_s is None:
            self.began_s = now_s
        self.said.take(robot, report)
        for clock in (event.detail for event in happened if event.kind == "clock"):
            logger.warning(
                "robot %d stands still: its clock is %s s ahead of that of its positions (NTP or PTP would help)",
                robot,
                clock.get("ahead_s"),
            )
        for entry in (*happened, *report.calls):
            self._sink.write(entry.model_copy(update={"round": self._current_row}))

    def _check_report(self, robot: int, report: RobotReport) -> None:
        """A MessageError if a report is none of this robot's in this team, or no record has room for it."""
        dim = self.mission.dim
        if report.waypoint is not None and len(report.waypoint) != dim:
            raise MessageError("wrong_length", f"a position of {len(report.waypoint)} coordinates, not {dim}")
        if report.plan is not None:
            check_plan_sent(report.plan, self.mission.n_robots, dim)
            if report.plan.digest != report.plan_id:
                raise MessageError("malformed", "places of another plan than the digest names")
        if any(entry.robot != robot for entry in (*report.happened, *report.calls)):
            raise MessageError("impostor", f"robot {robot} reports an event or a call of another robot")
        try:
            self._state(np.zeros((1, dim)), [report])
        except ValidationError as error:
            raise MessageError("malformed", f"no record holds it: {error.errors()[0]['msg']}") from None

    def _is_news(self, accuser: int, accusation: Mapping[str, Any]) -> bool:
        """Whether a robot is shown to lie for the first time; accusations that prove nothing are dropped."""
        if self._judge is None or self._unproven[accuser] >= MAX_UNPROVEN:
            return False
        if accusation.get("robot") in range(self.mission.n_robots) and accusation["robot"] in self.shown_to_lie:
            return False
        found = self._judge.confirms(accusation, [self.mission])
        if found is None or not 0 <= found[0] < self.mission.n_robots:
            self._unproven[accuser] += 1
            return False
        self.shown_to_lie[found[0]] = found[1]
        return True

    def _take_places(self, robot: int, report: RobotReport) -> None:
        """Keep the places of a plan, and record it, when they are told for the first time."""
        plan_id, plan = report.plan_id, report.plan
        if plan_id is None or plan is None or not self.said.take_places(robot, plan_id, plan.points):
            return
        places, proposer = [list(point) for point in plan.points], report.proposer or 0
        self._sink.write(PlanInfo(round=self._current_row, plan_id=plan_id, proposer=proposer, points=places))

    def _take_mission(self, report: RobotReport) -> None:
        """Follow the team to another mission; a MessageError if it cannot be its, or the operator has not signed it."""
        counter, digest = report.mission
        if report.shape is None or counter <= self._counter:
            return
        # Before anything is read that takes time.
        if self._signed is not None and not self._signed(MissionStamp(counter, digest), report.order):
            raise MessageError("no_order", f"the operator has not signed mission {counter}")
        try:
            mission = Mission.model_validate(report.shape)
        except ValidationError as error:
            raise MessageError("malformed", f"a mission: {input_error(error, Mission)}") from None
        except FlockError as error:
            raise MessageError("malformed", f"a mission: {error}") from None
        if (mission.digest, mission.n_robots, mission.dim) != (digest, self.mission.n_robots, self.mission.dim):
            raise MessageError("malformed", "a mission of another team, or another one than its digest names")
        self._counter = counter
        self._set_mission(mission)
        self._record_mission(self._current_row + 1)

    def _record_mission(self, first: int) -> None:
        self._sink.write(mission_info(self.mission, self._missions, first))
        self._missions += 1

    @property
    def ordered_at(self) -> int:
        return self._counter

    def state(self) -> State | None:
        """Every robot as it is now, with the number of the last row; None before the first world state."""
        if self._world is None:
            return None
        return self._state(np.array([body.position for body in self._world.bodies]), self._last_reports)

    @property
    def _last_reports(self) -> list[RobotReport | None]:
        """By id; None of a robot that is not alive."""
        return [self.reports.get(robot) if robot in self.alive else None for robot in range(self.mission.n_robots)]

    def _state(self, positions: Points, reports: Sequence[RobotReport | None]) -> State:
        """Every robot, for bodies at positions of shape (n, d) [units]; one that was never seen sleeps."""
        row = self._current_row
        goals = [None if report is None else self.goal_of(report) for report in reports]
        start = Origin.START.value if row == 0 else Origin.HOLD.value
        gone = [DEAD if robot in self._seen else ASLEEP for robot in range(len(reports))]
        return State(
            round=row,
            positions=positions.tolist(),
            goals=[None if goal is None else list(goal) for goal in goals],
            slots=[None if r is None else r.slot for r in reports],
            plan_ids=[None if r is None else r.plan_id for r in reports],
            influence=[0.0 if r is None else r.neighbors / self.mission.n_robots for r in reports],
            waypoints=[None if r is None or r.waypoint is None else list(r.waypoint) for r in reports],
            origins=[start if r is None else r.origin for r in reports],
            open_breakers=[[] if r is None else list(r.breakers) for r in reports],
            phases=[none if r is None else r.phase for r, none in zip(reports, gone, strict=True)],
        )

    @property
    def robots(self) -> list[int]:
        """Robots that are alive and have reported, by id."""
        return sorted(self.alive & self.reports.keys())

    @property
    def supplier(self) -> tuple[int, str | None] | None:
        """Proposer of the plan that most living robots follow, and who made it; None without such a plan."""
        plans = Counter((self.reports[robot].plan_id, self.reports[robot].proposer) for robot in self.robots)
        (plan_id, proposer), count = plans.most_common(1)[0] if plans else ((None, None), 0)
        if plan_id is None or proposer is None or 2 * count <= len(self.robots):
            return None
        return proposer, self.said.supplier(plan_id, proposer)

    @property
    def hopeless(self) -> str | None:
        """The reason why no robot has a plan, once no model is asked for one any more; else None."""
        reasons = [self.reports[robot].hopeless for robot in self.robots]
        found = [reason for reason in reasons if reason is not None]
        if not found or len(found) < len(self.alive):
            return None
        count, reason = commonest(found)
        return f"{count} of {len(found)} robots: {reason}"

    @property
    def rejected(self) -> dict[str, int]:
        return rejected(self.reports.values())

    @property
    def mission_s(self) -> float | None:
        """Time from the first robot's first round until the team formed [s]; None if it has not."""
        return None if self.formed_s is None or self.began_s is None else self.formed_s - self.began_s

    def check(self) -> None:
        """Check whether the team is in order; once per step time, write a row of the record."""
        now = self._clock()
        if self._world is None:
            return
        self._take_leave(now)
        robots = self.robots
        positions = np.array([body.position for body in self._world.bodies])
        goals = {robot: self.goal_of(self.reports[robot]) for robot in robots}
        distances = [
            math.inf if goal is None else float(np.linalg.norm(positions[robot] - goal))
            for robot, goal in goals.items()
        ]
        complete = self._target is not None and len(robots) == self.mission.n_places
        error = self._target.error(positions[robots].tolist()).mean if complete and self._target else None
        self._update_formed(now, robots, distances, error)
        if now >= self._row_due:
            self._row_due = max(self._row_due + self._config.network.step_s, now)
            self._write(positions, robots, distances, error)

    def goal_of(self, report: RobotReport) -> Point | None:
        """A robot's place, by the plan and the slot that it names; None without one."""
        places = self.said.places.get(report.plan_id or "", ())
        return None if report.slot is None or report.slot >= len(places) else places[report.slot]

    def _update_formed(self, now: float, robots: list[int], distances: list[float], error: float | None) -> None:
        reports = [self.reports[robot] for robot in robots]
        places = self.said.places.get((reports[0].plan_id if reports else None) or "", ())
        witnesses = Counter(slot for report in reports for slot in set(report.blocked))
        blocked = [slot for slot, count in witnesses.items() if count >= min(self._witnesses, len(reports))]
        stamp, replans = (self._counter, self.mission.digest), self._config.protocol.gaps == "replan"
        fit = not replans or fits(self.mission, len(places), len(robots))
        self._formed.update(
            now,
            self._row + 1,
            plan_ids=[r.plan_id if fit and tuple(r.mission) == stamp and not r.replans else None for r in reports],
            slots=[report.slot for report in reports],
            goal_distances=distances,
            residual=error,
            usable=len(places) - len(blocked),
        )

    def _write(self, positions: Points, robots: list[int], distances: list[float], error: float | None) -> None:
        if self._row < 0:
            self._record_mission(0)
        self._row += 1
        self._seen |= set(robots)
        self._sink.write(self._state(positions, self._last_reports))
        near = graph.distances(positions) <= self.mission.comm_range
        messages, volume = sent(self.reports.values())
        plan_ids = [self.reports[robot].plan_id for robot in robots]
        row = MetricsRow(
            round=self._row,
            procrustes_mean=error,
            procrustes_mean_squared=None,
            min_separation=finite(metrics.min_separation(positions, self.mission.downwash)),
            segment_separation=finite(self._row_closest),
            plans_in_use=metrics.plans_in_use(plan_ids),
            distinct_goals=metrics.distinct_goals(plan_ids, [self.reports[robot].slot for robot in robots]),
            robots_at_goal=metrics.robots_at_goal(distances, self.mission.spacing),
            in_order_since=self._formed.since_row if self.in_order else None,
            connected=graph.is_connected(near[np.ix_(robots, robots)]) if robots else False,
            model_calls=self.said.calls,
            tokens=self.said.tokens,
            cost_usd=None,
            messages_sent=messages,
            bytes_sent=volume,
            messages_rejected=self.rejected,
        )
        self._sink.write(row)
        self._row_closest = math.inf
        self._sink.write(RoundEnd(round=self._row))
        self._on_row(TrialProgress.of(row, rounds=0, n_robots=len(robots)))
