"""Keeps the books of one run: counts everything, and writes it to the record in a fixed order."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from typing import Any

from llm_flock import metrics
from llm_flock.arrays import Points
from llm_flock.llm.port import Attempt, Usage
from llm_flock.mission import Mission
from llm_flock.obstacles import segment_clearance
from llm_flock.protocol.events import MoveTo, Note, Origin
from llm_flock.protocol.plan import Plan
from llm_flock.record.schema import (
    CallUsage,
    ChatLine,
    LlmEntry,
    MetricsRow,
    MissionInfo,
    PlanInfo,
    ProtocolEvent,
    State,
)
from llm_flock.record.writer import NullWriter, RecordSink
from llm_flock.runtime.bodies import Bodies
from llm_flock.runtime.episode import Episode, blocked_places
from llm_flock.runtime.roster import Roster
from llm_flock.transport.memory import Traffic

ERROR_EVERY_ROUND_UP_TO = 300
"""Up to so many robots the shape error is measured after every round. Its search takes seconds for a thousand, so a
larger team is measured when all are at their goals, which `formed` needs anyway, and at the end."""


class Journal:
    """Counts and records one run.

    Attempts and notes of a round are held back until `flush`, and written in the order of the robots: the order in
    which models answer must not show in the record, which is the same for the same seed.

    Args:
        mission: the first mission.
        writer: takes the record.
        replans: whether the team has its plan remade when robots die: only such a plan counts as formed then.
    """

    def __init__(self, mission: Mission, writer: RecordSink, *, replans: bool = False) -> None:
        self.mission = mission
        self._replans = replans
        self.writer = writer
        # What nobody reads is not put together. A class derived from NullWriter may read what it likes.
        self._read = type(writer) is not NullWriter
        self.calls = 0
        self.calls_rejected = 0
        self.calls_failed = 0
        self.usage = Usage()
        self.cost_usd: float | None = 0.0
        self.latency_s = 0.0
        self.faults: Counter[str] = Counter()
        self.waypoints: Counter[str] = Counter()
        self.min_separation = float("inf")
        self.min_clearance = float("inf")
        self.start = metrics.StartSeparation(mission.safe_distance)
        self.positions: list[Points] = []
        self.errors: list[tuple[float, float] | None] = []
        self.episodes: list[Episode] = []
        self.robot_rounds = 0
        self.rejected_before: Counter[str] = Counter()
        self.at_goal = 0
        self.silent_rounds = 0
        self.last_failure: str | None = None
        self._calls_before = (0, 0)
        self._known_plans: set[str] = set()
        self._attempts: list[Attempt] = []
        self._previous: Points | None = None

    @property
    def episode(self) -> Episode:
        """The mission in force: the last one that was given."""
        return self.episodes[-1]

    def mission_given(self, mission: Mission, flown: int, positions: Points) -> None:
        """A mission is in force from the next round on: its figures begin afresh."""
        ideal = None if mission.ideal is None else [list(point) for point in mission.ideal]
        version, first = len(self.episodes), flown + 1 if self.episodes else 0
        fields = mission.model_dump(mode="json")
        self.writer.mission(MissionInfo(version=version, round=first, mission=fields, ideal=ideal))
        self.episodes.append(Episode(mission, flown, positions))

    def close_episode(self, roster: Roster) -> None:
        """The mission in force is over, by another one or by the end of the run."""
        self.episode.close(roster.awake, roster.awake_agents())

    def attempt(self, attempt: Attempt) -> None:
        """Take note of one model call; one that the budget refused was never made, and is only recorded."""
        self._attempts.append(attempt)
        if attempt.error is not None:
            self.last_failure = ": ".join(attempt.error)
        if attempt.error is not None and attempt.error[0] == "budget":
            return
        self.calls += 1
        self.latency_s += attempt.latency_s
        if attempt.faults:
            self.faults.update(attempt.faults)
        if attempt.reply is None:
            self.calls_failed += 1
        else:
            self.calls_rejected += attempt.rejected is not None
            self.usage = self.usage + attempt.reply.usage
            cost = attempt.reply.cost_usd
            self.cost_usd = None if cost is None or self.cost_usd is None else self.cost_usd + cost

    def flush_attempts(self) -> None:
        """Write the model calls made since the last flush, by robot and attempt."""
        if self._read:
            for attempt in sorted(self._attempts, key=lambda a: (a.call.robot, a.call.attempt)):
                self.writer.llm(llm_entry(attempt))
        self._attempts.clear()

    def note(self, round_number: int, comm_round: int | None, robot: int, note: Note) -> None:
        """Record something that a robot decided or met."""
        if self._read:
            self.writer.event(
                ProtocolEvent(
                    round=round_number, comm_round=comm_round, robot=robot, kind=note.kind, detail=dict(note.detail)
                )
            )

    def plan(self, round_number: int, plan: Plan, proposer: int) -> None:
        """Record a plan's points when it is first seen."""
        if plan.digest not in self._known_plans:
            self._known_plans.add(plan.digest)
            self.writer.plan(
                PlanInfo(
                    round=round_number,
                    plan_id=plan.digest,
                    proposer=proposer,
                    points=[list(point) for point in plan.points],
                )
            )

    def state(
        self,
        round_number: int,
        team: Bodies,
        roster: Roster,
        moves: Mapping[int, MoveTo] | None,
        traffic: Traffic,
    ) -> None:
        """Record where everybody is, what everybody follows, and the figures of this round."""
        calls, failed = self.calls - self._calls_before[0], self.calls_failed - self._calls_before[1]
        self._calls_before = (self.calls, self.calls_failed)
        # A round in which somebody flew on along a path is not one in which no model is of any use.
        silent = bool(calls) and calls == failed and not any(mind.on_path for mind in roster.awake_agents())
        self.silent_rounds = self.silent_rounds + 1 if silent else 0
        flown = dict[int, MoveTo]() if moves is None else moves
        self.robot_rounds += len(flown)
        self.waypoints.update(move.origin.value for move in flown.values())
        positions = team.positions
        if self._read:
            still = Origin.START if moves is None else Origin.HOLD
            self.writer.state(_state(round_number, positions, team, roster, flown, still))
        self._measure(round_number, positions, team, roster, traffic)

    def measure_error(self, roster: Roster) -> None:
        """Measure the shape error of the last round, if the ideal shape is known and it was not measured yet.

        Only as many robots as there are places can be compared with a shape: all that are awake, or, where some of
        them are spare, those with a place.
        """
        if self.errors[-1] is not None:
            return
        robots = roster.awake
        minds = [roster.agents[robot] for robot in robots]
        plan = self.episode.plan(minds)
        places = self.episode.mission.n_places if plan is None else len(plan)
        if len(robots) > places:
            robots = [robot for robot in robots if roster.agents[robot].claim.slot is not None]
        if len(robots) == places:
            shape = self.episode.error(self.positions[-1][robots])
            self.errors[-1] = None if shape is None else (shape.mean, shape.mean_squared)

    def _measure(self, round_number: int, positions: Points, team: Bodies, roster: Roster, traffic: Traffic) -> None:
        self.positions.append(positions)
        separation = metrics.min_separation(positions)
        along = None if self._previous is None else metrics.segment_separation(self._previous, positions)
        if self.mission.obstacles:
            before = positions if self._previous is None else self._previous
            for here, there in zip(before.tolist(), positions.tolist(), strict=True):
                way = segment_clearance(tuple(here), tuple(there), self.mission.obstacles)
                self.min_clearance = min(self.min_clearance, way)
        self._previous = positions
        closest = separation if along is None else min(separation, along)
        self.min_separation = min(self.min_separation, closest)
        self.start.update(round_number, positions, closest)
        minds, rows = roster.awake_agents(), positions.tolist()
        plan_ids = [None if a.plan is None else a.plan.digest for a in minds]
        slots = [a.claim.slot for a in minds]
        distances = [
            float("inf") if (g := a.goal) is None else math.dist(rows[robot], g)
            for robot, a in zip(roster.awake, minds, strict=True)
        ]
        episode = self.episode
        self.at_goal = metrics.robots_at_goal(distances, episode.mission.spacing)
        plan = episode.plan(minds)
        places = episode.mission.n_places if plan is None else len(plan)
        usable = places - len(blocked_places(minds))
        self.errors.append(None)
        if len(roster.agents) <= ERROR_EVERY_ROUND_UP_TO or self.at_goal == min(usable, len(minds)):
            self.measure_error(roster)
        error = self.errors[-1]
        fits = not self._replans or plan is None or episode.fits(plan, len(minds))
        to_goals = [distance for distance, slot in zip(distances, slots, strict=True) if slot is not None]
        if error is not None or episode.mission.ideal is None or not to_goals:
            residual = None if error is None else error[0]
        else:  # with gaps the shape is judged by the places that are filled
            residual = sum(to_goals) / len(to_goals)
        episode.tracker.update(
            round_number,
            plan_ids=[p if fits and episode.follows(a) else None for p, a in zip(plan_ids, minds, strict=True)],
            slots=slots,
            goal_distances=distances,
            residual=residual,
            usable=usable,
        )
        if self._read:
            self.writer.metrics(
                MetricsRow(
                    round=round_number,
                    procrustes_mean=None if error is None else error[0],
                    procrustes_mean_squared=None if error is None else error[1],
                    min_separation=_finite(separation),
                    segment_separation=None if along is None else _finite(along),
                    plans_in_use=metrics.plans_in_use(plan_ids),
                    distinct_goals=metrics.distinct_goals(plan_ids, slots),
                    robots_at_goal=self.at_goal,
                    connected=team.connected(roster.awake),
                    model_calls=self.calls,
                    tokens=self.usage.total,
                    cost_usd=self.cost_usd,
                    messages_sent=traffic.sent,
                    bytes_sent=traffic.bytes,
                    messages_rejected=dict(self.rejected(roster)),
                )
            )

    def rejected(self, roster: Roster) -> Counter[str]:
        """Messages refused so far, by reason, those of robots that have started again since included."""
        return sum((a.rejected for a in roster.agents), self.rejected_before)


def _state(
    round_number: int, positions: Points, team: Bodies, roster: Roster, flown: Mapping[int, MoveTo], still: Origin
) -> State:
    """Where everybody is, and what everybody follows; `still` is the origin of who was commanded nothing."""
    robots = range(len(roster.agents))
    minds = [agent if robot in roster.awake else None for robot, agent in enumerate(roster.agents)]
    return State(
        round=round_number,
        positions=positions.tolist(),
        goals=[None if a is None or (g := a.goal) is None else list(g) for a in minds],
        slots=[None if a is None else a.claim.slot for a in minds],
        plan_ids=[None if a is None or a.plan is None else a.plan.digest for a in minds],
        influence=[len(roster.hears(team, robot)) / len(minds) for robot in robots],
        waypoints=[list(flown[robot].waypoint) if robot in flown else None for robot in robots],
        origins=[(flown[robot].origin if robot in flown else still).value for robot in robots],
        phases=[roster.phase(robot) for robot in robots],
    )


def _finite(value: float) -> float | None:
    """None for the infinite separation of a single robot, which JSON cannot say."""
    return value if value < float("inf") else None


def llm_entry(attempt: Attempt) -> LlmEntry:
    """A model call as it is recorded."""
    call, reply = attempt.call, attempt.reply
    settings: dict[str, Any] = {} if reply is None else dict(reply.settings)
    usage = Usage() if reply is None else reply.usage
    return LlmEntry(
        round=call.round,
        robot=call.robot,
        kind=call.kind,
        attempt=call.attempt,
        model=attempt.model,
        request_hash=call.request_hash,
        messages=[ChatLine(role=m.role, text=m.text) for m in call.messages],
        text=None if reply is None else reply.text,
        parsed=None if attempt.parsed is None else dict(attempt.parsed),
        rejected=attempt.rejected,
        error=None if attempt.error is None else ": ".join(attempt.error),
        settings=settings,
        usage=CallUsage(input=usage.input, output=usage.output, cached=usage.cached),
        cost_usd=None if reply is None else reply.cost_usd,
        latency_s=attempt.latency_s,
        faults=list(attempt.faults),
    )
