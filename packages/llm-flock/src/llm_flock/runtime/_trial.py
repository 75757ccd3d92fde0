"""One trial in one process: motion rounds in lockstep, in which all robots ask their models at the same time."""

from __future__ import annotations

import asyncio
import re
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Self, TypeAlias, TypeVar

import msgspec
import numpy as np

from llm_flock import events
from llm_flock.agent import Agent
from llm_flock.arrays import Points
from llm_flock.errors import InputError, unknown
from llm_flock.events import AskJudgement, AskPlan, AskStep, Broadcast, Effect, Event, MoveTo, Note, Origin
from llm_flock.links import MemoryTransport
from llm_flock.message import order_time
from llm_flock.mission import Mission
from llm_flock.planner import (
    JudgementAnswer,
    JudgementQuestion,
    NoAnswer,
    PlanAnswer,
    PlanQuestion,
    StepAnswer,
    StepQuestion,
)
from llm_flock.record._schema import MetricsRow
from llm_flock.runtime._config import RunConfig
from llm_flock.runtime._journal import Journal
from llm_flock.runtime._planners import TeamPlanners
from llm_flock.runtime._roster import Roster, make_agent, parts_of
from llm_flock.runtime._rules import Rules
from llm_flock.runtime._schedule import MAX_ROUNDS, Stream, stream
from llm_flock.simulate import Bodies, start_positions

T = TypeVar("T")

WAIT_S = 10.0  # time between two notes of who waits for a model [s]
STEP_TOLERANCE = 1e-3  # share of the step limit that a step may be longer by: waypoints are rounded


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialProgress:
    """The figures that a live display shows after each round, and every WAIT_S while robots wait for their models.

    `round` is the last one flown; `waiting` has the robots that wait for an answer of the next one, and `waited_s` how
    long they have waited [s].
    """

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
    waiting: tuple[int, ...] = ()
    waited_s: float = 0.0

    @property
    def text(self) -> str:
        """The figures in a line."""
        if self.waiting:
            robots = ", ".join(map(str, self.waiting[:10])) + (", ..." if len(self.waiting) > 10 else "")
            late = f"no answer for {self.waited_s:.0f} s: {len(self.waiting)} of {self.n_robots} robots ({robots})"
            return f"round {self.round + 1} · {late} · calls {self.model_calls} · tokens {self.tokens:,}"
        error = "" if self.error is None else f" · error {self.error:.2f}"
        cost = "" if not self.cost_usd else f" · {self.cost_usd:.4f} USD"
        return (
            f"round {self.round} · at goal {self.at_goal}/{self.n_robots} · plans {self.plans_in_use} · "
            f"goals {self.distinct_goals}{error} · calls {self.model_calls} · tokens {self.tokens:,}{cost}"
        )

    @classmethod
    def of(cls, row: MetricsRow, *, rounds: int, n_robots: int) -> Self:
        """The figures of a round, in a team of `n_robots` that flies at most `rounds` rounds, 0 if unknown."""
        return cls(
            round=row.round,
            rounds=rounds,
            at_goal=row.robots_at_goal,
            n_robots=n_robots,
            plans_in_use=row.plans_in_use,
            distinct_goals=row.distinct_goals,
            error=row.procrustes_mean,
            model_calls=row.model_calls,
            tokens=row.tokens,
            cost_usd=row.cost_usd,
        )


def _new_agent(config: RunConfig, rules: Rules, robot: int) -> Agent:
    return make_agent(config, robot, parts_of(config, rules, robot))


def starts_of(config: RunConfig) -> Points:
    """Where the robots of a run start, shape (n, d) [units]."""
    trial, rng = config.trial, stream(config.trial.seed, Stream.START)
    return start_positions(config.start_scene, trial.start_positions, trial.start, rng, trial.start_area)


class Trial:
    """Drives agents, bodies, planners and messages through one mission, from `start`, of shape (n, d) [units].

    `steer` is awaited before each round, and may change the schedule, the links and the planners.
    """

    def __init__(
        self,
        config: RunConfig,
        rules: Rules,
        planners: TeamPlanners,
        bodies: Bodies,
        journal: Journal,
        start: Points,
        on_round: Callable[[TrialProgress], None] | None = None,
        steer: Steer | None = None,
    ) -> None:
        n_robots = config.mission.n_robots
        self.config = config
        self.schedule = config.schedule()
        self.roster = Roster(partial(_new_agent, config, rules), n_robots, self.schedule.asleep)
        self.planners = planners
        self.bodies = bodies
        self.transport = MemoryTransport(n_robots, config.links, stream(config.trial.seed, Stream.LINKS))
        self.journal = journal
        journal.begin_mission(config.mission, 0, start)
        self.round = 0
        self._stamp = (0, config.mission.digest)  # of the last mission that any robot has begun
        self.stopped = "rounds"
        self.reason: str | None = None
        self._on_round = on_round
        self._steer = steer
        self._moves: dict[int, MoveTo] = {}
        self._judging: dict[int, JudgementQuestion] = {}
        self._left: dict[int, float] = {}  # how far robots with weak batteries can fly [units]
        self._check = collision_check(config.protocol.collision_check or "none")
        self.began = time.perf_counter()

    @property
    def rounds(self) -> int:
        """The last round of this run: as configured, or else the team's present deadline."""
        if self.config.trial.rounds is not None:
            return self.config.trial.rounds
        after = self._notice_round if self.schedule.last <= self.round else self.schedule.last
        if self.schedule.kills and (self.config.protocol.gaps == "replan" or self.config.protocol.judge == "models"):
            # No robot plans for fewer before the search for the others has ended, and its turn has come.
            from llm_flock.protocol._membership.search import longest_search
            from llm_flock.protocol._membership.team import MAX_WAIT, REPLAN_PATIENCE

            missing = sum(map(len, self.schedule.kills.values()))
            after += longest_search(self.journal.episode.mission, missing) + REPLAN_PATIENCE + MAX_WAIT
        awake, pace = self.roster.awake, 1 + self.config.sight.rests
        due, mission = self.journal.episode.deadline(awake, self.roster.awake_agents(), after, pace), self.mission
        if mission.then and (when := mission.then[0].when) != "formed":
            return MAX_ROUNDS if when == "order" else max(due, when)
        formed = self.journal.episode.formed_at
        # Until every robot has heard that all others stand at their places.
        return due if formed is None else max(due, formed + mission.hold + mission.n_robots * bool(mission.then) + 10)

    @property
    def mission(self) -> Mission:
        """The mission in force: the last one that any robot has begun."""
        return self.journal.episode.mission

    async def run(self) -> None:
        """Fly rounds until the formation is held, rounds or budget are used up, or no model gives usable answers."""
        self.begin()
        try:
            while self.round < self.rounds:
                if self._steer is not None:
                    await self._steer(self)
                await self._fly_round(self.round + 1)
                self._report()
                if self.find_end():
                    break
        except asyncio.CancelledError:
            self.stopped = "interrupted"
            raise
        except Exception as error:
            from llm_flock.user_code import describe_exception

            self.stopped, self.reason = "failed", describe_exception(error)
            raise
        finally:
            for agent in self.roster.agents:
                agent.handle(events.Stopped())

    def begin(self) -> None:
        """Record the start positions. Call before the first round; further calls do nothing."""
        if not self.journal.positions:
            self.journal.end_round(0, self.bodies, self.roster, None, self.transport.traffic)

    def find_end(self) -> bool:
        """Whether the run ends before its last round: formed, out of budget, or hopeless. Call after a round."""
        if self._is_done:
            self.stopped = "formed"
        elif self.planners.exhausted:
            self.stopped = "budget"
        else:
            return self._find_hopeless()
        return True

    def _find_hopeless(self) -> bool:
        """Whether the run can no longer succeed: no robot has a plan, and no model gives one. Sets the reason."""
        if self.config.protocol.fallback == "hold":
            silent = self.journal.silent_rounds >= 3  # every call failed
            if silent:
                self.stopped, self.reason = "no_answers", self.journal.last_failure
            return silent
        failures = [agent.hopeless for agent in self.roster.awake_agents()]
        hopeless = [failure for failure in failures if failure is not None]
        if self.schedule.last > self.round or len(hopeless) < len(failures) or not hopeless:
            return False
        answered = any(failure.cause in ("answer", "unverified", "slow") for failure in hopeless)
        self.stopped = "no_plan" if answered else "no_answers"
        count, reason = commonest([failure.reason for failure in hopeless])
        self.reason = f"{count} of {len(hopeless)} robots: {reason}"
        return True

    @property
    def _notice_round(self) -> int:
        """The round by which others have noticed the last death, and looked for the dead robot."""
        kills = self.schedule.kills
        if not kills:
            return 0
        from llm_flock.protocol._membership.liveness import patience

        time_out = patience(self.config.protocol.time_out, self.config.mission.n_robots)
        rounds_to_look = 10 if self.config.protocol.judge == "rule" else 20  # and to choose, and to plan again
        return max(kills) + time_out + rounds_to_look

    @property
    def _is_done(self) -> bool:
        """Whether the formation is held, and no event is left in the schedule."""
        tracker, schedule = self.journal.episode.tracker, self.schedule
        if not self.config.trial.stop_when_formed or tracker.formed_at is None or self.round < schedule.last:
            return False
        if self.mission.then or self.round < tracker.formed_at + self.mission.hold:
            return False
        return tracker.held and self.round >= self._notice_round

    def _carry_out_schedule(self, number: int) -> None:
        """Carry out the schedule of this round: deaths, then joins, then other missions."""
        journal, roster, schedule = self.journal, self.roster, self.schedule
        killed, joined = schedule.kills.get(number, ()), schedule.joins.get(number, ())
        for robot in killed:
            roster.kill(robot)
            journal.note(number, None, robot, Note("killed", {}))
        for robot in joined:
            journal.rejected_before += roster.join(robot).rejected
            journal.note(number, None, robot, Note("joined", {}))
        for robot, left in schedule.weak.get(number, ()):
            if robot in roster.awake:
                self._left[robot] = left
                self._send(robot, events.BatteryWeak(left))
        if killed or joined or number in (*schedule.weak, *schedule.orders) or number == schedule.crossed:
            journal.episode.disturb(number - 1)
        for count, (robot, mission) in enumerate(schedule.missions.get(number, ())):
            journal.close_episode(roster)
            self._begin(mission, order_time(number, count))
            self._send(robot, events.MissionGiven(mission=mission, ordered_at=order_time(number, count)))
        for robot, words in schedule.orders.get(number, ()):
            self._send(robot, events.OrderGiven(words, number))
        if self.mission.then and journal.episode.formed_at is not None and journal.episode.bound is None:
            journal.close_episode(roster)  # robots may go on at any moment, and forget their plan

    def _begin(self, mission: Mission, ordered_at: int) -> None:
        self._stamp = (ordered_at, mission.digest)
        self.journal.begin_mission(mission, self.round, self.bodies.positions)

    def _follow(self, agent: Agent) -> None:
        """Note that a robot has gone on to the next stage by itself."""
        if self.mission.then and (agent.ordered_at, agent.mission.digest) > self._stamp:
            if self.journal.episode.bound is None:
                self.journal.close_episode(self.roster)
            self._begin(agent.mission, agent.ordered_at)

    async def _fly_round(self, number: int) -> None:
        questions = self.plan_questions(number)
        asked = {robot: self.planners[robot].plan(question) for robot, question in questions.items()}
        plans = await _all(asked, self._report)
        judging = {robot: self._judge(robot, question) for robot, question in self._judging.items()}
        for robot, answer in (await _all(judging, self._report)).items():
            self._send(robot, events.Judged(answer))
        self.journal.flush_attempts()
        self.take_plans(plans)
        asking = self.step_questions()
        steps = await self.ask_steps(asking)
        if self._check is not None:
            steps = await self._check(self, asking, steps)
        self.journal.flush_attempts()
        moves = self.take_steps(steps)
        for robot, move in moves.items():
            if move.origin is Origin.MODEL and self.planners.model_of(robot) == "geometry":
                moves[robot] = msgspec.structs.replace(move, origin=Origin.GEOMETRY)
        await self.bodies.fly(self.displacements(moves))
        self.end_round(number, moves)

    def plan_questions(self, number: int) -> dict[int, PlanQuestion]:
        """Begin a round: carry out its schedule, let robots sense, and return the questions of those without a plan."""
        self._carry_out_schedule(number)
        asking: dict[int, PlanQuestion] = {}
        self._judging.clear()
        observe_all = self.config.model.observe == "all"
        for robot in self.roster.awake:
            sensing = self.bodies.readings.sense(robot)
            observed = self.bodies.readings.others(robot) if observe_all else tuple(sensing.sensed.values())
            event = events.RoundBegan(
                round=number,
                position=sensing.position,
                degree=len(self.roster.hears(self.bodies, robot)),
                sensed=sensing.sensed,
                observed=observed,
                moving=sensing.moving,
            )
            for effect in self._send(robot, event):
                if isinstance(effect, AskPlan):
                    asking[robot] = effect.question
                elif isinstance(effect, AskJudgement):
                    self._judging[robot] = effect.question
            self._follow(self.roster.agents[robot])
        return asking

    async def _judge(self, robot: int, question: JudgementQuestion) -> JudgementAnswer | NoAnswer:
        judge = getattr(self.planners[robot], "judge", None)
        return NoAnswer(cause="answer", reason="no model is asked") if judge is None else await judge(question)

    def take_plans(self, answers: Mapping[int, PlanAnswer | NoAnswer]) -> None:
        """Give the robots that asked their answers; then all robots exchange messages."""
        for robot, answer in answers.items():
            self._send(robot, events.Planned(answer))
        for comm_round in range(self.config.protocol.comm_rounds or 1):
            self._exchange(comm_round)

    def _exchange(self, comm_round: int) -> None:
        """One communication round: all robots broadcast, then all receive, then all decide on the same snapshot."""
        awake, listening = self.roster.awake, set(self.roster.awake)
        receivers = self.roster.reaches if self.config.protocol.relay else self.roster.hears
        for robot in awake:
            for effect in self._send(robot, events.CommRoundBegan(), comm_round):
                if isinstance(effect, Broadcast):
                    self.transport.broadcast(effect.payload, receivers(self.bodies, robot), robot)
        for robot, payload in self.transport.deliver():
            if robot in listening:  # a message may arrive after its receiver has died
                self._send(robot, events.Received(payload), comm_round)
        for robot in awake:
            self._send(robot, events.CommRoundEnded(), comm_round)

    def step_questions(self) -> dict[int, StepQuestion]:
        """End the exchange of messages. Returns the questions for waypoints; other robots decide by themselves."""
        asking: dict[int, StepQuestion] = {}
        self._moves.clear()
        for robot in self.roster.awake:
            for effect in self._send(robot, events.AgreementEnded()):
                if isinstance(effect, AskStep):
                    asking[robot] = effect.question
                elif isinstance(effect, MoveTo):
                    self._moves[robot] = effect
        return asking

    async def ask_steps(self, asking: Mapping[int, StepQuestion]) -> dict[int, StepAnswer | NoAnswer]:
        """Put each robot's question to its planner, all at once."""
        asked = {robot: self.planners[robot].step(question) for robot, question in asking.items()}
        return await _all(asked, self._report)

    def take_steps(self, answers: Mapping[int, StepAnswer | NoAnswer]) -> dict[int, MoveTo]:
        """Give the robots that asked their answers; returns the move of each robot that is awake."""
        for robot, answer in answers.items():
            for effect in self._send(robot, events.Decided(answer)):
                if isinstance(effect, MoveTo):
                    self._moves[robot] = effect
        return dict(sorted(self._moves.items()))

    def displacements(self, moves: Mapping[int, MoveTo]) -> Points:
        """The displacement of each body from its believed position, shape (n, d) [units]; zero for silent robots.

        No body flies farther in a round than `max_step`: a longer step ends there, in its direction, and is counted.
        """
        displacements: Points = np.zeros_like(self.bodies.positions)
        if not moves:
            return displacements
        believed: Points = np.array([self.roster.agents[robot].position for robot in moves])
        displacements[list(moves)] = np.array([move.waypoint for move in moves.values()]) - believed
        longest = self.config.mission.max_step
        lengths = np.linalg.norm(displacements, axis=1)
        over = lengths > longest * (1 + STEP_TOLERANCE)
        displacements[over] *= longest / lengths[over, None]
        self.journal.steps_over_limit += int(over.sum())
        for robot in sorted(self._left.keys() & moves.keys()):
            left, way = self._left[robot], float(np.linalg.norm(displacements[robot]))
            self._left[robot] = max(0.0, left - way)
            if way <= left:
                continue
            displacements[robot] *= left / way
            kills, number = self.schedule.kills, self.round + 2
            dying = {one for when, some in kills.items() if when >= number for one in some}
            # Its body stops there, and the robot is dead from the next round on; the last one only stops.
            if robot not in dying and {*self.roster.awake} - dying - {robot}:
                self.schedule = replace(self.schedule, kills={**kills, number: (*kills.get(number, ()), robot)})
        return displacements

    def end_round(self, number: int, moves: Mapping[int, MoveTo]) -> None:
        """Tell the robots that they have arrived, and record the round. Call when the bodies have moved."""
        for robot in self.roster.awake:
            self._send(robot, events.Arrived())
        self.journal.end_round(number, self.bodies, self.roster, moves, self.transport.traffic)
        self.round = number

    def _send(self, robot: int, event: Event, comm_round: int | None = None) -> list[Effect]:
        """Give a robot's agent an event of the next round. Records notes among its effects, and returns the others."""
        effects = self.roster.agents[robot].handle(event)
        if not effects:
            return effects
        for effect in effects:
            if isinstance(effect, Note):
                self.journal.note(self.round + 1, comm_round, robot, effect)
                if effect.kind == "proposed":
                    by = self.planners.model_of(robot) if effect.detail["by"] == "model" else "geometry"
                    self.journal.record_proposal(self.round + 1, self.roster.agents[robot], by)
        return [effect for effect in effects if not isinstance(effect, Note)]

    def _report(self, waiting: tuple[int, ...] = (), waited_s: float = 0.0) -> None:
        if self._on_round is not None and self.journal.row is not None:
            now = TrialProgress.of(self.journal.row, rounds=self.rounds, n_robots=len(self.roster.awake))
            calls, tokens = self.journal.calls, self.journal.usage.total
            self._on_round(replace(now, model_calls=calls, tokens=tokens, waiting=waiting, waited_s=waited_s))


def commonest(reasons: Sequence[str]) -> tuple[int, str]:
    """The count of the commonest reason, and its first wording; reasons that differ in numbers only are the same."""
    kinds = [re.sub(r"[0-9.]+", "0", reason) for reason in reasons]
    kind, count = Counter(kinds).most_common(1)[0]
    return count, reasons[kinds.index(kind)]


async def _all(
    asking: Mapping[int, Coroutine[Any, Any, T]], tell: Callable[[tuple[int, ...], float], None]
) -> dict[int, T]:
    """Await the answers of all robots at once, and `tell` now and then which wait and how long [s].

    The first error of a planner is raised, and cancels the others.
    """
    if not asking:
        return {}
    began = time.perf_counter()
    try:
        async with asyncio.TaskGroup() as group:
            tasks = {robot: group.create_task(question) for robot, question in asking.items()}
            while waiting := [task for task in tasks.values() if not task.done()]:
                if (await asyncio.wait(waiting, timeout=WAIT_S))[1]:
                    late = tuple(robot for robot, task in tasks.items() if not task.done())
                    tell(late, time.perf_counter() - began)
    except ExceptionGroup as errors:
        raise errors.exceptions[0] from None
    return {robot: task.result() for robot, task in tasks.items()}


CollisionCheck: TypeAlias = Callable[
    [Trial, Mapping[int, StepQuestion], Mapping[int, StepAnswer | NoAnswer]],
    Awaitable[dict[int, StepAnswer | NoAnswer]],
]
"""Sees all questions and answers of a round before they are flown, and returns the answers to fly."""


def collision_check(name: str) -> CollisionCheck | None:
    """The check of this name, which a plug-in brings; None for `none`. InputError if there is no such check."""
    if name == "none":
        return None
    from llm_flock import plugins

    if name not in plugins.entries("collision_checks"):
        raise InputError(
            "collision_check", name, says=unknown("check", name, ("none", *plugins.entries("collision_checks")))
        )
    return plugins.load("collision_checks", name)


Steer: TypeAlias = Callable[[Trial], Awaitable[None]]
"""Steers a trial in flight: awaited before each round, which is number `trial.round + 1`."""
