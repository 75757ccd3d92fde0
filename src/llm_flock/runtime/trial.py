"""One trial in one process: motion rounds in lockstep, all robots of a round thinking at once."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from llm_flock import metrics
from llm_flock.arrays import Points
from llm_flock.protocol.agent import Agent
from llm_flock.protocol.events import (
    Arrived,
    AskPlan,
    AskStep,
    Broadcast,
    Decided,
    Effect,
    MoveTo,
    NegotiationEnded,
    Note,
    Planned,
    Received,
    RoundBegan,
    Stopped,
    TickBegan,
    TickEnded,
)
from llm_flock.protocol.planning import NoAnswer, PlanAnswer, StepAnswer
from llm_flock.robots.simulated import SimulatedTeam
from llm_flock.runtime.config import RunConfig
from llm_flock.runtime.journal import Journal
from llm_flock.runtime.result import RunResult, Summary
from llm_flock.runtime.team import Thinkers
from llm_flock.transport.memory import MemoryTransport

T = TypeVar("T")

SILENT_ROUNDS = 3
"""Rounds on end in which every model call fails, after which a run is not worth its waits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """What a live display needs to know after each round."""

    round: int
    rounds: int
    at_goal: int
    n_robots: int
    plans_in_use: int
    distinct_goals: int
    error: float | None
    model_calls: int
    tokens: int
    cost_usd: float | None


class Trial:
    """Drives agents, bodies, planners and messages through one mission.

    Args:
        config: everything that defines the run.
        agents: one mind per robot.
        thinkers: one planner per robot, and what the models have used.
        bodies: the simulated bodies and sensors.
        transport: carries the messages.
        journal: counts and records.
        on_round: told after each round, for a live display.
    """

    def __init__(
        self,
        config: RunConfig,
        agents: Sequence[Agent],
        thinkers: Thinkers,
        bodies: SimulatedTeam,
        transport: MemoryTransport,
        journal: Journal,
        on_round: Callable[[Progress], None] | None = None,
    ) -> None:
        self.config = config
        self.agents = list(agents)
        self.thinkers = thinkers
        self.bodies = bodies
        self.transport = transport
        self.journal = journal
        self.round = 0
        self.stopped = "rounds"
        self.reason: str | None = None
        self._on_round = on_round
        self._began = time.perf_counter()

    async def run(self) -> None:
        """Fly rounds until the formation is held, the rounds or the budget are used up, or no model answers any more.

        Raises:
            asyncio.CancelledError: after the record was brought to a readable end by `finish`.
        """
        self.journal.state(0, self.bodies, self.agents, None, self.transport.traffic)
        self.journal.writer.end_round(0)
        try:
            while self.round < self.config.trial.rounds:
                await self._fly_round(self.round + 1)
                self.round += 1
                self._report()
                if self.config.trial.stop_when_formed and self.journal.tracker.formed_at is not None:
                    self.stopped = "formed"
                    break
                if self.thinkers.exhausted:
                    self.stopped = "budget"
                    break
                if self.journal.silent_rounds >= SILENT_ROUNDS:
                    self.stopped, self.reason = "no_answers", self.journal.last_failure
                    break
        except asyncio.CancelledError:
            self.stopped = "interrupted"
            raise
        except Exception as error:
            self.stopped, self.reason = "failed", f"{type(error).__name__}: {error}"
            raise
        finally:
            for agent in self.agents:
                agent.handle(Stopped())

    async def _fly_round(self, number: int) -> None:
        await self._think_plans(number)
        for tick in range(self.config.protocol.ticks or 1):
            self._exchange(number, tick)
        moves = await self._think_steps(number)
        self._move(moves)
        for robot, agent in enumerate(self.agents):
            self._perform(number, None, robot, agent.handle(Arrived()))
        self.journal.state(number, self.bodies, self.agents, moves, self.transport.traffic)
        self.journal.writer.end_round(number)

    async def _think_plans(self, number: int) -> None:
        """Sense; robots without a plan ask for one, all at once."""
        asking: dict[int, Awaitable[PlanAnswer | NoAnswer]] = {}
        everybody = self.config.model.observe == "all"
        for robot, agent in enumerate(self.agents):
            seen = self.bodies.sense(robot)
            observed = self.bodies.everybody(robot) if everybody else tuple(seen.sensed.values())
            began = RoundBegan(
                round=number,
                position=seen.position,
                neighbors=len(self.bodies.in_radio_range[robot]),
                sensed=seen.sensed,
                observed=observed,
            )
            for effect in self._perform(number, None, robot, agent.handle(began)):
                if isinstance(effect, AskPlan):
                    asking[robot] = self.thinkers.planners[robot].plan(effect.question)
        answers = await _all(asking)
        self.journal.flush_attempts()
        for robot, answer in answers.items():
            agent = self.agents[robot]
            self._perform(number, None, robot, agent.handle(Planned(answer)))
            if isinstance(answer, PlanAnswer):
                self.journal.plan(number, answer.plan, robot)

    def _exchange(self, number: int, tick: int) -> None:
        """One message exchange: all broadcast, then all receive, then all decide on the same snapshot."""
        for robot, agent in enumerate(self.agents):
            for effect in self._perform(number, tick, robot, agent.handle(TickBegan())):
                if isinstance(effect, Broadcast):
                    self.transport.broadcast(effect.payload, self.bodies.in_radio_range[robot])
        for robot, payload in self.transport.deliver():
            self._perform(number, tick, robot, self.agents[robot].handle(Received(payload)))
        for robot, agent in enumerate(self.agents):
            self._perform(number, tick, robot, agent.handle(TickEnded()))

    async def _think_steps(self, number: int) -> list[MoveTo]:
        """Robots with a goal ask for a waypoint, all at once; returns every robot's move."""
        asking: dict[int, Awaitable[StepAnswer | NoAnswer]] = {}
        moves: dict[int, MoveTo] = {}
        for robot, agent in enumerate(self.agents):
            for effect in self._perform(number, None, robot, agent.handle(NegotiationEnded())):
                if isinstance(effect, AskStep):
                    asking[robot] = self.thinkers.planners[robot].step(effect.question)
                elif isinstance(effect, MoveTo):
                    moves[robot] = effect
        answers = await _all(asking)
        self.journal.flush_attempts()
        for robot, answer in answers.items():
            for effect in self._perform(number, None, robot, self.agents[robot].handle(Decided(answer))):
                if isinstance(effect, MoveTo):
                    moves[robot] = effect
        return [moves[robot] for robot in range(len(self.agents))]

    def _move(self, moves: Sequence[MoveTo]) -> None:
        """Bodies fly what was commanded, from where each robot believed it was."""
        believed: Points = np.array([agent.position for agent in self.agents])
        commanded: Points = np.array([move.waypoint for move in moves])
        self.bodies.move(commanded - believed)

    def _perform(self, number: int, tick: int | None, robot: int, effects: list[Effect]) -> list[Effect]:
        """Record the notes among the effects; return the rest."""
        rest: list[Effect] = []
        for effect in effects:
            if isinstance(effect, Note):
                self.journal.note(number, tick, robot, effect)
            else:
                rest.append(effect)
        return rest

    def _report(self) -> None:
        if self._on_round is None:
            return
        journal = self.journal
        plan_ids = [None if a.plan is None else a.plan.digest for a in self.agents]
        error = journal.errors[-1]
        self._on_round(
            Progress(
                round=self.round,
                rounds=self.config.trial.rounds,
                at_goal=journal.at_goal,
                n_robots=len(self.agents),
                plans_in_use=metrics.plans_in_use(plan_ids),
                distinct_goals=metrics.distinct_goals(plan_ids, [a.claim.slot for a in self.agents]),
                error=None if error is None else error[0],
                model_calls=journal.calls,
                tokens=journal.usage.total,
                cost_usd=journal.cost_usd,
            )
        )

    def finish(self, record: str | None) -> RunResult:
        """The result so far; writes it to the record. Call once, also after a cancelled `run`."""
        self.journal.flush_attempts()
        if self.stopped != "interrupted":  # whoever presses Ctrl-C does not wait for figures
            self.journal.measure_error()
        summary = self._summary(record)
        self.journal.writer.summary(summary.to_dict())
        return RunResult(
            mission=self.config.mission,
            config=self.config,
            summary=summary,
            positions=np.array(self.journal.positions),
            errors=np.array([np.nan if e is None else e[0] for e in self.journal.errors]),
            plans=tuple(a.plan for a in self.agents),
            slots=tuple(a.claim.slot for a in self.agents),
        )

    def _summary(self, record: str | None) -> Summary:
        journal, config = self.journal, self.config
        plan_ids = [None if a.plan is None else a.plan.digest for a in self.agents]
        slots = [a.claim.slot for a in self.agents]
        bound = self._lower_bound(plan_ids)
        first = journal.tracker.formed_at
        error = journal.errors[-1]
        rejected = sum((a.rejected for a in self.agents), type(self.agents[0].rejected)())
        broadcasts = self.transport.traffic
        return Summary(
            shape=config.mission.shape,
            n_robots=config.mission.n_robots,
            seed=config.trial.seed,
            consensus=config.protocol.consensus or "",
            assignment=config.protocol.assignment or "",
            shield=bool(config.protocol.shield),
            models=tuple(dict.fromkeys(self.thinkers.names)),
            simulated=self.thinkers.simulated,
            stopped=self.stopped,
            reason=self.reason,
            rounds=self.round,
            formed=first is not None and bound is not None and metrics.within_limit(first, bound),
            rounds_to_formed=first,
            lower_bound_rounds=bound,
            procrustes_mean=None if error is None else error[0],
            procrustes_mean_squared=None if error is None else error[1],
            min_separation=_finite(journal.min_separation),
            start_violations=journal.start.start_violations,
            rounds_to_separate=journal.start.separated_at,
            min_separation_after_start=_finite(journal.start.smallest),
            min_clearance=_finite(journal.min_clearance),
            plans_in_use=metrics.plans_in_use(plan_ids),
            distinct_goals=metrics.distinct_goals(plan_ids, slots),
            robots_without_plan=plan_ids.count(None),
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
            waypoints=dict(sorted(journal.waypoints.items())),
            messages_sent=broadcasts.sent,
            bytes_per_robot_round=broadcasts.bytes / (len(self.agents) * max(1, self.round)),
            messages_rejected=dict(sorted(rejected.items())),
            wall_s=time.perf_counter() - self._began,
            record=record,
        )

    def _lower_bound(self, plan_ids: list[str | None]) -> int | None:
        """Rounds that even a perfect central planner would need from the start to the agreed plan."""
        plan = self.agents[0].plan
        if plan is None or len(set(plan_ids)) != 1:
            return None
        return metrics.lower_bound_rounds(self.journal.positions[0], plan.array, self.config.mission.max_step)


def _finite(value: float) -> float | None:
    """None for an infinite distance, which JSON cannot say."""
    return value if value < float("inf") else None


async def _all(asking: dict[int, Awaitable[T]]) -> dict[int, T]:
    """Await everybody's answer at once, by robot.

    Raises:
        Exception: the first one that a planner raised; the others are cancelled.
    """

    async def one(question: Awaitable[T]) -> T:
        return await question

    if not asking:
        return {}
    try:
        async with asyncio.TaskGroup() as group:
            tasks = {robot: group.create_task(one(question)) for robot, question in asking.items()}
    except ExceptionGroup as errors:
        raise errors.exceptions[0] from None
    return {robot: task.result() for robot, task in tasks.items()}
