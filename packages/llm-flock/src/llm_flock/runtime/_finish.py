"""Ends a trial: its summary, which completes the record, and its result."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np

from llm_flock import metrics
from llm_flock.arrays import Vector
from llm_flock.events import Origin
from llm_flock.llm._providers import habits_of
from llm_flock.record._schema import SummaryMessage
from llm_flock.runtime._journal import finite
from llm_flock.runtime._result import FlightFigures, MissionOutcome, RunResult, Summary, by_origin, waypoint_shares
from llm_flock.runtime._trial import Trial


def finish_trial(trial: Trial, record: str | None, flight: FlightFigures | None = None) -> RunResult:
    """The result so far; also writes it to the record. Call once, also after a cancelled `run`."""
    trial.journal.flush_attempts()
    if trial.stopped != "interrupted":  # after Ctrl-C, end without delay
        trial.journal.measure_error(trial.roster)
    summary = _summarize(trial, record, flight)
    trial.journal.writer.write(SummaryMessage(result=summary.to_dict()))
    return RunResult(
        mission=trial.config.mission,
        config=trial.config,
        summary=summary,
        positions=np.array(trial.journal.positions),
        errors=np.array([np.nan if e is None else e.mean for e in trial.journal.errors]),
        plans=tuple(a.plan for a in trial.roster.agents),
        slots=tuple(a.claim.slot for a in trial.roster.agents),
        trace=None if trial.journal.trace is None else tuple(trial.journal.trace),
        unrepeatable=tuple(trial.journal.unrepeatable),
    )


def _summarize(trial: Trial, record: str | None, flight: FlightFigures | None) -> Summary:
    """The summary of a stopped trial, with the path of its record and a flight's figures."""
    config, journal, roster = trial.config, trial.journal, trial.roster
    planners, traffic = trial.planners, trial.transport.traffic
    agents, episode = roster.awake_agents(), journal.episode
    plan_ids = [None if a.plan is None else a.plan.digest for a in agents]
    slots = [a.claim.slot for a in agents]
    plan, owned = episode.plan(agents), {slot for slot in slots if slot is not None}
    origin = None if plan is None else agents[0].provenance
    by = None if plan is None or origin is None else journal.suppliers.get((plan.digest, origin.proposer))
    taught = None if by in (None, "geometry") else habits_of(by).taught
    waypoints = by_origin(journal.waypoints)
    journal.close_episode(roster)
    error = journal.errors[-1]
    left = len(trial.mission.then)
    if left and trial.reason is None:
        trial.reason = f"{left} of the mission's stages {'was' if left == 1 else 'were'} not entered"
    # A run that an error ends, or before the last stage, has formed nothing, whatever it had come to.
    formed = episode.formed_at is not None and trial.stopped != "failed" and not left
    return Summary(
        shape=config.mission.shape,
        n_robots=config.mission.n_robots,
        seed=config.trial.seed,
        consensus=config.protocol.consensus or "",
        assignment=config.protocol.assignment or "",
        shield=bool(config.protocol.shield),
        models=tuple(dict.fromkeys((*planners.names, *map(planners.model_of, range(config.mission.n_robots))))),
        simulated=planners.simulated,
        stopped=trial.stopped,
        reason=trial.reason,
        rounds=trial.round,
        formed=formed,
        formed_by_models=formed
        and "geometry" not in (by, *planners.names)
        and not journal.breakers_opened
        and not journal.waypoints[Origin.GEOMETRY.value],
        formed_half_tolerance=episode.trackers[0.5].formed_at is not None,
        formed_twice_tolerance=episode.trackers[2.0].formed_at is not None,
        rounds_to_formed=episode.rounds_to_formed,
        lower_bound_rounds=episode.bound,
        procrustes_mean=None if error is None else error.mean,
        procrustes_mean_squared=None if error is None else error.mean_squared,
        min_separation=finite(journal.min_separation),
        start_violations=journal.start.start_violations,
        nearest_read=finite(trial.bodies.readings.nearest_read),
        rounds_to_separate=journal.start.separated_at,
        min_separation_after_start=finite(journal.start.smallest),
        min_clearance=finite(journal.min_clearance),
        obstacle_violations=journal.obstacle_violations,
        plans_in_use=metrics.plans_in_use(plan_ids),
        distinct_goals=metrics.distinct_goals(plan_ids, slots),
        robots_without_plan=plan_ids.count(None),
        awake=len(agents),
        model_calls=journal.calls,
        calls_rejected=journal.calls_rejected,
        calls_failed=journal.calls_failed,
        faults=dict(sorted(journal.faults.items())),
        tokens=journal.usage.total,
        tokens_input=journal.usage.input,
        tokens_output=journal.usage.output,
        tokens_cached=journal.usage.cached,
        cost_usd=journal.cost_usd,
        latency_mean_s=journal.latency_s / journal.calls if journal.calls else None,
        waypoints=waypoints,
        waypoint_shares=waypoint_shares(waypoints),
        steps_over_limit=journal.steps_over_limit,
        center_distance=_center_distance(trial),
        plan_robot=None if origin is None else origin.proposer,
        plan_by=by,
        plan_taught=None if taught is None else taught(trial.mission),
        breakers_opened=tuple(sorted(journal.breakers_opened)),
        messages_sent=traffic.sent,
        bytes_per_robot_round=traffic.bytes / max(1, journal.robot_rounds),
        messages_rejected=dict(sorted(journal.rejected(roster).items())),
        wall_s=time.perf_counter() - trial.began,
        record=record,
        killed=_turns(trial.schedule.kills, trial.round),
        joined=_turns(trial.schedule.joins, trial.round),
        missions=tuple(
            MissionOutcome(
                round=part.flown + 1 if part.flown else 0,
                shape=part.mission.shape,
                places=part.mission.n_places,
                formed=part.formed_at,
                lower_bound_rounds=part.bound,
            )
            for part in journal.episodes
        ),
        gaps=None if plan is None else len(plan) - len(owned),
        spares=None if plan is None else slots.count(None),
        flight=flight,
        answered_by=tuple(sorted(journal.answered_by)),
    )


def _center_distance(trial: Trial) -> float | None:
    """The mean of the robots' offsets from their places, which other plans and dead robots do not shift."""
    offsets: list[Vector] = []
    for robot in trial.roster.awake:
        agent = trial.roster.agents[robot]
        if agent.plan is not None and agent.goal is not None:
            plan_offset = agent.plan.array.mean(axis=0) - agent.mission.center
            offsets.append(trial.journal.positions[-1][robot] - agent.goal + plan_offset)
    return float(np.linalg.norm(np.mean(offsets, axis=0))) if offsets else None


def _turns(by_round: Mapping[int, tuple[int, ...]], rounds: int) -> tuple[str, ...]:
    """The events up to a round, in the notation of the command line."""
    return tuple(f"{robot}@{when}" for when, robots in sorted(by_round.items()) if when <= rounds for robot in robots)
