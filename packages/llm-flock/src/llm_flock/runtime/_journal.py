"""Counts the events of one run, and writes them to the record in a fixed order."""

from __future__ import annotations

import math
import os
import platform
import subprocess
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from importlib import metadata as installed
from pathlib import Path

import numpy as np

from llm_flock import metrics
from llm_flock.agent import Agent
from llm_flock.arrays import Points
from llm_flock.events import MoveTo, Note, Origin
from llm_flock.links import Traffic
from llm_flock.llm._port import Attempt, Usage
from llm_flock.mission import Mission
from llm_flock.obstacles import segment_clearance
from llm_flock.record._schema import (
    CallUsage,
    ChatLine,
    Entry,
    LlmEntry,
    MetricsRow,
    MissionInfo,
    NullWriter,
    PlanInfo,
    ProtocolEvent,
    RecordSink,
    RoundEnd,
    RunInfo,
    State,
)
from llm_flock.runtime._config import RunConfig
from llm_flock.runtime._episode import Episode, blocked_places, fits
from llm_flock.runtime._roster import Roster
from llm_flock.simulate import Bodies

_PACKAGES = (
    *("llm-flock", "numpy", "scipy", "pydantic", "pydantic-ai-slim", "openai", "anthropic", "jinja2", "mcap"),
    "xllamacpp",
)


def versions() -> dict[str, str]:
    """Versions of this package and of those that can change a result."""
    by_name: dict[str, str] = {}
    for name in _PACKAGES:
        try:
            by_name[name] = installed.version(name)
        except installed.PackageNotFoundError:
            by_name[name] = "not installed"
    return by_name


def git_revision() -> str | None:
    """Revision of the checkout that this package runs from, `+dirty` with local changes; None outside a checkout."""
    describe = ("describe", "--always", "--abbrev=40", "--exclude=*", "--dirty=+dirty")
    # Many workers ask at once, so git must not lock the index. On a busy machine this takes seconds.
    environment = {**os.environ, "GIT_OPTIONAL_LOCKS": "0"}
    command = ["git", "-C", str(Path(__file__).parent), *describe]
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60.0, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def run_info(
    config: RunConfig, *, simulated: bool, weights: Mapping[str, str] | None = None, unrepeatable: Sequence[str] = ()
) -> RunInfo:
    """The origin of a run: configuration, versions (also of weights on board), and machine without any name or path.

    Paths of the run's files are left out: the same run elsewhere leaves the same record.
    """
    machine = {"python": platform.python_version(), "platform": platform.platform(), "machine": platform.machine()}
    return RunInfo(
        config=config.model_dump(mode="json", exclude={"trial": {"out"}, "model": {"record_llm"}}),
        versions={**versions(), **(weights or {})},
        git_revision=git_revision(),
        seed=config.trial.seed,
        simulated=simulated,
        unrepeatable=list(unrepeatable) or None,
        created_at=datetime.now(UTC).isoformat(timespec="seconds"),
        environment=machine,
    )


def mission_info(mission: Mission, version: int, first_round: int) -> MissionInfo:
    """A mission as it is recorded; `version` counts the missions of a run from 0."""
    ideal = None if mission.ideal is None else [list(point) for point in mission.ideal]
    return MissionInfo(version=version, round=first_round, mission=mission.model_dump(mode="json"), ideal=ideal)


def finite(value: float | None) -> float | None:
    """None for an infinite distance (of one robot alone), which JSON cannot represent."""
    return value if value is not None and value < math.inf else None


def llm_entry(attempt: Attempt) -> LlmEntry:
    """A model call as it is recorded."""
    fields = attempt.told()
    fields |= {
        "messages": [ChatLine(role=m.role, text=m.text) for m in attempt.call.messages],
        "parsed": None if attempt.parsed is None else dict(attempt.parsed),
        "probe": attempt.call.probe or None,
        "error": None if attempt.error is None else ": ".join(attempt.error),
        "thought": attempt.reply.thought or None,
        "usage": CallUsage(**asdict(attempt.reply.usage)),
        "faults": list(attempt.reply.faults),
    }
    return LlmEntry(**{name: fields[name] for name in LlmEntry.model_fields})


ERROR_EVERY_ROUND_UP_TO = 300
"""Team size up to which the shape error is measured after every round: the search takes seconds for a thousand robots.
A larger team is measured when all are at their goals, which `formed` needs anyway, and at the end."""


class Journal:
    """Counts and records one run; for a `NullWriter` no entries are built.

    If the team replans after deaths, only a plan of the right size, which no robot is about to leave, then counts as
    formed. With `trace`, missions, plans, states and figures are also kept in memory, to draw the run.
    """

    def __init__(self, config: RunConfig, writer: RecordSink, *, trace: bool = False) -> None:
        self.mission, self._moving = config.mission, config.trial.moving_obstacles
        self._replans = config.protocol.gaps == "replan"
        self.writer = writer
        self._recording = not isinstance(writer, NullWriter)
        self.trace: list[Entry] | None = [] if trace else None
        self.unrepeatable: list[str] = []
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
        self.obstacle_violations = 0
        self.start = metrics.StartSeparation(config.mission.safe_distance, config.mission.downwash)
        self.positions: list[Points] = []
        self.errors: list[metrics.ShapeError | None] = []
        self.episodes: list[Episode] = []
        self.robot_rounds = 0
        self.steps_over_limit = 0
        self.rejected_before: Counter[str] = Counter()
        self.row: MetricsRow | None = None
        self.silent_rounds = 0
        self.last_failure: str | None = None
        self._calls_before = (0, 0)
        self.answered_by: set[str] = set()
        self.suppliers: dict[tuple[str, int], str] = {}
        self.breakers_opened: set[int] = set()
        self._known_plans: set[str] = set()
        self._attempts: list[Attempt] = []

    @property
    def episode(self) -> Episode:
        """The mission in force: the last one that was given."""
        return self.episodes[-1]

    def begin_mission(self, mission: Mission, flown: int, positions: Points) -> None:
        """A mission is in force from the next round on; its measurements start now."""
        first = flown + 1 if self.episodes else 0
        self._put(mission_info(mission, len(self.episodes), first))
        self.episodes.append(Episode(mission, flown, positions))

    def close_episode(self, roster: Roster) -> None:
        """The mission in force is over: another one begins, or the run ends."""
        asleep = np.delete(self.positions[-1], roster.awake, axis=0)
        self.episode.close(roster.awake, roster.awake_agents(), asleep)

    def attempt(self, attempt: Attempt) -> None:
        """Count one model call. A call beyond the budget was never made, and is only recorded."""
        if self._recording:
            self._attempts.append(attempt)
        if attempt.error is not None:
            self.last_failure = ": ".join(attempt.error)
            if attempt.error[0] == "budget":
                return
        self.calls += 1
        self.latency_s += attempt.reply.latency_s
        self.faults.update(attempt.reply.faults)
        if attempt.error is not None:
            self.calls_failed += 1
        else:
            self.calls_rejected += attempt.rejected is not None
            self.usage += attempt.reply.usage
            self.answered_by.add(attempt.reply.model)
            cost = attempt.reply.cost_usd
            self.cost_usd = None if cost is None or self.cost_usd is None else self.cost_usd + cost

    def flush_attempts(self) -> None:
        """Write the model calls since the last flush, sorted by robot: a record does not depend on their timing."""
        for attempt in sorted(self._attempts, key=lambda a: (a.call.robot, a.call.attempt)):
            self.writer.write(llm_entry(attempt))
        self._attempts.clear()

    def note(self, round_number: int, comm_round: int | None, robot: int, note: Note) -> None:
        """Record a note of a robot."""
        if note.kind == "breaker" and note.detail["state"] == "open":
            self.breakers_opened.add(robot)
        if self._recording:
            kind, detail = note.kind, dict(note.detail)
            event = ProtocolEvent(round=round_number, comm_round=comm_round, robot=robot, kind=kind, detail=detail)
            self.writer.write(event)

    def record_proposal(self, round_number: int, agent: Agent, by: str) -> None:
        """Record the points of a robot's own plan once; `by` is the name of a model, or geometry."""
        plan = agent.plan
        assert plan is not None, "a robot follows its own proposal"
        self.suppliers[plan.digest, agent.robot] = by
        if plan.digest not in self._known_plans:
            self._known_plans.add(plan.digest)
            points = [list(point) for point in plan.points]
            self._put(PlanInfo(round=round_number, plan_id=plan.digest, proposer=agent.robot, points=points))

    def end_round(
        self, round_number: int, team: Bodies, roster: Roster, moves: Mapping[int, MoveTo] | None, traffic: Traffic
    ) -> None:
        """Record positions and measurements. Call after every round, and before the first one without moves."""
        calls, failed = self.calls - self._calls_before[0], self.calls_failed - self._calls_before[1]
        self._calls_before = (self.calls, self.calls_failed)
        # While a robot flies on along its path, the run goes on without answers.
        silent = bool(calls) and calls == failed and not any(agent.on_path for agent in roster.awake_agents())
        self.silent_rounds = self.silent_rounds + 1 if silent else 0
        flown = moves or {}
        self.robot_rounds += len(flown)
        self.waypoints.update(move.origin.value for move in flown.values())
        positions = team.positions
        if self._recording or self.trace is not None:
            idle = Origin.START if moves is None else Origin.HOLD
            agents = [agent if robot in roster.awake else None for robot, agent in enumerate(roster.agents)]
            robots = range(len(agents))
            state = State(
                round=round_number,
                positions=positions.tolist(),
                goals=[None if a is None or (goal := a.goal) is None else list(goal) for a in agents],
                slots=[None if a is None else a.claim.slot for a in agents],
                plan_ids=[None if a is None or a.plan is None else a.plan.digest for a in agents],
                influence=[len(roster.hears(team, robot)) / len(agents) for robot in robots],
                waypoints=[list(flown[robot].waypoint) if robot in flown else None for robot in robots],
                origins=[(flown[robot].origin if robot in flown else idle).value for robot in robots],
                open_breakers=[[] if a is None else list(a.open_breakers) for a in agents],
                phases=[roster.phase(robot) for robot in robots],
            )
            self._put(state)
        self._measure(round_number, positions, team, roster, traffic)
        self._put(RoundEnd(round=round_number))

    def _put(self, entry: Entry) -> None:
        """Write an entry that belongs to the trace too."""
        self.writer.write(entry)
        if self.trace is not None:
            self.trace.append(entry)

    def measure_error(self, roster: Roster) -> None:
        """Measure the shape error of the last round, if the ideal shape is known and it was not measured yet."""
        if self.errors[-1] is not None:
            return
        robots = roster.awake
        plan = self.episode.plan([roster.agents[robot] for robot in robots])
        places = self.episode.mission.n_places if plan is None else len(plan)
        if len(robots) > places:  # a shape can only be compared with as many robots as it has places
            robots = [robot for robot in robots if roster.agents[robot].claim.slot is not None]
        if len(robots) == places:
            self.errors[-1] = self.episode.error(self.positions[-1][robots])

    def _measure(self, round_number: int, positions: Points, team: Bodies, roster: Roster, traffic: Traffic) -> None:
        separation, on_segment = self._measure_separation(round_number, positions)
        agents, rows = roster.awake_agents(), positions.tolist()
        plan_ids = [None if a.plan is None else a.plan.digest for a in agents]
        slots = [a.claim.slot for a in agents]
        distances = [
            float("inf") if (goal := a.goal) is None else math.dist(rows[robot], goal)
            for robot, a in zip(roster.awake, agents, strict=True)
        ]
        episode = self.episode
        at_goal = metrics.robots_at_goal(distances, episode.mission.spacing)
        plan = episode.plan(agents)
        places = episode.mission.n_places if plan is None else len(plan)
        asleep = np.delete(positions, roster.awake, axis=0)
        usable = places - (0 if plan is None else len(blocked_places(agents, plan, asleep, episode.mission)))
        self.errors.append(None)
        if len(roster.agents) <= ERROR_EVERY_ROUND_UP_TO or at_goal == min(usable, len(agents)):
            self.measure_error(roster)
        error = self.errors[-1]
        fit = not self._replans or plan is None or fits(episode.mission, len(plan), len(agents))
        to_goals = [distance for distance, slot in zip(distances, slots, strict=True) if slot is not None]
        if error is not None or episode.mission.ideal is None or not to_goals:
            residual = None if error is None else error.mean
        else:  # with gaps, the shape is measured by the places that are filled
            residual = sum(to_goals) / len(to_goals)
        stays = [fit and episode.follows(a) and not a.replans for a in agents]
        followed = [plan_id if stay else None for plan_id, stay in zip(plan_ids, stays, strict=True)]
        for tracker in episode.trackers.values():
            tracker.update(
                round_number,
                plan_ids=followed,
                slots=slots,
                goal_distances=distances,
                residual=residual,
                usable=usable,
            )
        self.row = MetricsRow(
            round=round_number,
            procrustes_mean=None if error is None else error.mean,
            procrustes_mean_squared=None if error is None else error.mean_squared,
            min_separation=finite(separation),
            segment_separation=finite(on_segment),
            plans_in_use=metrics.plans_in_use(plan_ids),
            distinct_goals=metrics.distinct_goals(plan_ids, slots),
            robots_at_goal=at_goal,
            in_order_since=episode.tracker.since,
            connected=team.readings.connected(roster.awake),
            model_calls=self.calls,
            tokens=self.usage.total,
            cost_usd=self.cost_usd,
            messages_sent=traffic.sent,
            bytes_sent=traffic.bytes,
            messages_rejected=dict(self.rejected(roster)),
        )
        self._put(self.row)

    def _measure_separation(self, round_number: int, positions: Points) -> tuple[float, float | None]:
        """Smallest distance of two robots now, and while they moved here (None at the start) [units]."""
        before, downwash = self.positions[-1] if self.positions else positions, self.mission.downwash
        separation = metrics.min_separation(positions, downwash)
        on_segment = metrics.segment_separation(before, positions, downwash=downwash) if self.positions else None
        if self.mission.obstacles:
            for start, end in zip(before.tolist(), positions.tolist(), strict=True):
                clearance = segment_clearance(tuple(start), tuple(end), self.mission.obstacles)
                self.min_clearance = min(self.min_clearance, clearance)
        for one in self._moving:
            ways = one.at(round_number - 1), one.at(round_number)
            gaps = metrics.passing_distances(before, positions, *map(np.array, ways)) - one.radius
            self.min_clearance = min(self.min_clearance, float(gaps.min()))
            self.obstacle_violations += int((gaps < self.mission.body_radius - metrics.ROUNDING).sum())
        self.positions.append(positions)
        closest = separation if on_segment is None else min(separation, on_segment)
        self.min_separation = min(self.min_separation, closest)
        self.start.update(round_number, positions, closest)
        return separation, on_segment

    def rejected(self, roster: Roster) -> Counter[str]:
        """Number of messages rejected so far, by reason; also by robots that have restarted since."""
        return sum((a.rejected for a in roster.agents), self.rejected_before)
