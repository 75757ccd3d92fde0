"""Builds the entries of a record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from llm_flock import metrics
from llm_flock.arrays import Points
from llm_flock.llm.port import Attempt, Usage
from llm_flock.mission import Mission
from llm_flock.protocol.events import MoveTo, Origin
from llm_flock.record.schema import CallUsage, ChatLine, LlmEntry, MetricsRow, MissionInfo, RunInfo, State
from llm_flock.runtime import versions
from llm_flock.runtime.bodies import Bodies
from llm_flock.runtime.config import RunConfig
from llm_flock.runtime.roster import Roster


def run_info(config: RunConfig, *, simulated: bool, weights: Mapping[str, str] | None = None) -> RunInfo:
    """The origin of a run: configuration, versions and machine.

    Args:
        config: everything that defines the run. Paths of its files are left out: the same run elsewhere leaves the
            same record.
        simulated: whether any language model is a simulated stand-in.
        weights: versions of the weights of models on board, by name.
    """
    return RunInfo(
        format_version=1,
        config=config.model_dump(mode="json", exclude={"trial": {"out"}, "model": {"record_llm"}}),
        versions={**versions.versions(), **(weights or {})},
        git_revision=versions.git_revision(),
        seed=config.trial.seed,
        simulated=simulated,
        created_at=versions.now(),
        environment=versions.environment(),
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
        phases=[roster.phase(robot) for robot in robots],
    )


def metrics_row(
    round_number: int,
    *,
    error: tuple[float, float | None] | None,
    separation: tuple[float, float | None],
    plan_ids: Sequence[str | None],
    slots: Sequence[int | None],
    at_goal: int,
    connected: bool,
    calls: tuple[int, int, float | None],
    traffic: tuple[int, int, Mapping[str, int]],
) -> MetricsRow:
    """The measurements of one round, as they are recorded.

    Args:
        round_number: motion round.
        error: mean distance to the ideal shape [units] and mean squared distance [units^2]; None where not known.
        separation: smallest distance of two robots now, and while they moved in this round [units]; infinite for one
            robot alone.
        plan_ids: the plan of each robot that is awake.
        slots: its slot in the plan.
        at_goal: robots at their goals.
        connected: whether the radio graph is one piece.
        calls: model calls, tokens, and cost [US dollars] so far.
        traffic: messages sent, bytes sent, and messages refused by reason so far.
    """
    mean, mean_squared = (None, None) if error is None else error
    return MetricsRow(
        round=round_number,
        procrustes_mean=mean,
        procrustes_mean_squared=mean_squared,
        min_separation=finite(separation[0]),
        segment_separation=finite(separation[1]),
        plans_in_use=metrics.plans_in_use(plan_ids),
        distinct_goals=metrics.distinct_goals(plan_ids, slots),
        robots_at_goal=at_goal,
        connected=connected,
        model_calls=calls[0],
        tokens=calls[1],
        cost_usd=calls[2],
        messages_sent=traffic[0],
        bytes_sent=traffic[1],
        messages_rejected=dict(traffic[2]),
    )


def mission_info(mission: Mission, version: int, first_round: int) -> MissionInfo:
    """A mission as it is recorded; `version` counts the missions of a run from 0."""
    ideal = None if mission.ideal is None else [list(point) for point in mission.ideal]
    return MissionInfo(version=version, round=first_round, mission=mission.model_dump(mode="json"), ideal=ideal)


def finite(value: float | None) -> float | None:
    """None for an infinite distance, which JSON cannot represent."""
    return value if value is not None and value < float("inf") else None


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
