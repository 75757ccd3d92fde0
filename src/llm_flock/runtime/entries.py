"""Builds the entries of a record."""

from __future__ import annotations

import math
import platform
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, TypedDict, Unpack

from llm_flock import metrics
from llm_flock.arrays import Points
from llm_flock.llm.port import Attempt, Usage
from llm_flock.mission import Mission
from llm_flock.protocol.events import MoveTo, Origin
from llm_flock.record.schema import CallUsage, ChatLine, LlmEntry, MetricsRow, MissionInfo, RunInfo, State
from llm_flock.runtime.bodies import Bodies
from llm_flock.runtime.config import RunConfig
from llm_flock.runtime.roster import Roster


def run_info(
    config: RunConfig,
    *,
    simulated: bool,
    weights: Mapping[str, str] | None = None,
    unrepeatable: Sequence[str] = (),
) -> RunInfo:
    """The origin of a run: configuration, versions (also of weights on board), and machine without any name or path.

    `unrepeatable` says what the configuration alone cannot repeat.

    Paths of the run's files are left out: the same run elsewhere leaves the same record.
    """
    from llm_flock.runtime import versions

    machine = {"python": platform.python_version(), "platform": platform.platform(), "machine": platform.machine()}
    return RunInfo(
        format_version=1,
        config=config.model_dump(mode="json", exclude={"trial": {"out"}, "model": {"record_llm"}}),
        versions={**versions.versions(), **(weights or {})},
        git_revision=versions.git_revision(),
        seed=config.trial.seed,
        simulated=simulated,
        unrepeatable=list(unrepeatable) or None,
        created_at=datetime.now(UTC).isoformat(timespec="seconds"),
        environment=machine,
    )


def state_entry(
    round_number: int, positions: Points, team: Bodies, roster: Roster, flown: Mapping[int, MoveTo], idle: Origin
) -> State:
    """Where the robots are and what they follow; `idle` is the origin for robots without a command."""
    robots = range(len(roster.agents))
    agents = [agent if robot in roster.awake else None for robot, agent in enumerate(roster.agents)]
    return State(
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


def mission_info(mission: Mission, version: int, first_round: int) -> MissionInfo:
    """A mission as it is recorded; `version` counts the missions of a run from 0."""
    ideal = None if mission.ideal is None else [list(point) for point in mission.ideal]
    return MissionInfo(version=version, round=first_round, mission=mission.model_dump(mode="json"), ideal=ideal)


class Totals(TypedDict):
    """Counts from the start of a run, by their fields of `MetricsRow`."""

    model_calls: int
    tokens: int
    cost_usd: float | None
    messages_sent: int
    bytes_sent: int
    messages_rejected: dict[str, int]


def metrics_row(
    round_number: int,
    *,
    plan_ids: Sequence[str | None],
    slots: Sequence[int | None],
    at_goal: int,
    error: tuple[float, float | None] | None,
    separation: float,
    on_segment: float | None,
    connected: bool,
    **totals: Unpack[Totals],
) -> MetricsRow:
    """The figures of one round, of robots with these plans and slots.

    `error` is the mean distance to the ideal shape [units] and the mean squared one [units^2]. `separation` is the
    smallest distance of two robots now, `on_segment` while they moved here [units].
    """
    mean, mean_squared = (None, None) if error is None else error
    return MetricsRow(
        round=round_number,
        procrustes_mean=mean,
        procrustes_mean_squared=mean_squared,
        min_separation=finite(separation),
        segment_separation=finite(on_segment),
        plans_in_use=metrics.plans_in_use(plan_ids),
        distinct_goals=metrics.distinct_goals(plan_ids, slots),
        robots_at_goal=at_goal,
        connected=connected,
        **totals,
    )


def finite(value: float | None) -> float | None:
    """None for an infinite distance (of one robot alone), which JSON cannot represent."""
    return value if value is not None and value < math.inf else None


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
        clipped=attempt.clipped,
        probe=True if call.probe else None,
        error=None if attempt.error is None else ": ".join(attempt.error),
        finish_reason=None if reply is None else reply.finish_reason,
        thought=True if reply is not None and reply.thought else None,
        settings=settings,
        usage=CallUsage(input=usage.input, output=usage.output, cached=usage.cached),
        cost_usd=None if reply is None else reply.cost_usd,
        latency_s=attempt.latency_s,
        faults=list(attempt.faults),
    )
