"""A PettingZoo environment: policies answer the robots' questions, or name their waypoints."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import chain, combinations
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from llm_flock.extras import EXTRAS

try:
    from gymnasium import spaces
    from pettingzoo import ParallelEnv  # pyright: ignore[reportMissingTypeStubs]
except ImportError as error:
    raise ImportError(f"llm_flock_lab._env needs PettingZoo: {EXTRAS['env'].install}") from error

from llm_flock.arrays import Points, flattened
from llm_flock.errors import InputError
from llm_flock.llm import CallLane, ModelPool
from llm_flock.metrics import ROUNDING, segment_separation
from llm_flock.mission import Mission
from llm_flock.plan import Plan
from llm_flock.planner import NoAnswer, PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol import geometric_plan
from llm_flock.record import NullWriter, RunRecord
from llm_flock.runtime import Journal, RunConfig, Stream, TeamPlanners, Trial, plain, starts_of, stream, trace_record
from llm_flock.simulate import InstantBodies, Readings, Sensing

Control: TypeAlias = Literal["waypoints", "questions"]
Observation: TypeAlias = dict[str, Any]
Action: TypeAlias = Any

NOTHING, PLAN, STEP = range(3)
"""What a robot asks its policy."""


class FlockEnv(ParallelEnv[str, Observation, Action]):
    """A team whose robots keep their protocol (messages, consensus, places, shield), and ask policies for the rest.

    With `control="waypoints"` a step is a round: geometry makes the plans, and an action is a displacement in shares of
    the step limit, shape (d,), each from -1 to 1; one longer than the limit is shortened. With `control="questions"` a
    step is a question: an action is a dict of `plan`, shape (places, d), `slot`, and `waypoint`, shape (d,) [units;
    world frame], of which the part counts that `asks` in the observation says: 1 a plan, 2 a step, 0 nothing.

    An observation is a dict of `asks`, `position`, `goal` (zeros without one, `has_goal` tells), `neighbors`, shape
    (N - 1, d), of which the first `n_neighbors` rows count, the `plan` that the robot follows (zeros without one), and
    its `slot` (the number of places without one) [units; world frame].

    A round's reward is the way gained to the robot's goal in step limits, -1 if it came nearer than the safe distance
    to another robot, and 10 for each robot when the team has formed, which ends the episode. Robots that die are
    terminated; after the last round all are truncated.

    Args:
        mission: the team's task; the paper's circle of ten if left out.
        control: what policies decide.
        render_mode: `rgb_array` for pictures, or None.
        fields: fields of the configuration. `fallback` is `hold` unless given, so that a policy is asked every round.

    Raises:
        InputError: a value is not allowed; among them models, mission changes and robots that join.
    """

    metadata: dict[str, Any] = {"name": "llm_flock_v0", "render_modes": ["rgb_array"], "render_fps": 6}  # noqa: RUF012

    def __init__(
        self,
        mission: Mission | None = None,
        *,
        control: Control = "waypoints",
        render_mode: Literal["rgb_array"] | None = None,
        **fields: Any,
    ) -> None:
        if control not in ("waypoints", "questions"):
            raise InputError("control", control, "waypoints or questions")
        if render_mode not in (None, "rgb_array"):
            raise InputError("render_mode", render_mode, "rgb_array or None")
        for field in ("model", "join", "join_random", "changes", "out", "record_llm"):
            if fields.get(field):
                raise InputError(field, fields[field], "nothing in an environment")
        base = {} if mission is None else {"mission": mission.model_dump(exclude_none=True)}
        given = {field: plain(field, value) for field, value in fields.items()}
        self.config = RunConfig.build(base, **{"fallback": "hold", **given, "model": "geometry"})
        self.config.protocol.rules()
        self.control: Control = control
        self.render_mode = render_mode
        self.mission = self.config.mission
        self.possible_agents = [f"robot_{robot}" for robot in range(self.mission.n_robots)]
        self.agents: list[str] = []
        self._observed = {agent: self._observation_space() for agent in self.possible_agents}
        self._allowed = {agent: self._action_space() for agent in self.possible_agents}
        self._seeds = np.random.default_rng(self.config.trial.seed)
        self._first = True
        self._trial: Trial | None = None
        self._plans: dict[int, PlanQuestion] = {}
        self._steps: dict[int, StepQuestion] = {}

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """The space of an agent's observations."""
        return self._observed[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """The space of an agent's actions."""
        return self._allowed[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Begin an episode. The seed decides starts, links and noise; without one, each episode draws another.

        The first episode has the seed of the configuration. `options` are not used.
        """
        if seed is not None:
            self._seeds = np.random.default_rng(seed)
        elif self._first:
            seed = self.config.trial.seed
        else:
            seed = int(self._seeds.integers(2**31))
        self._first = False
        trial = self.config.trial.model_copy(update={"seed": seed})
        self._config = self.config.model_copy(update={"trial": trial})
        self._trial, self._readings = begin_trial(self._config, trace=self.render_mode is not None)
        self._angles = [
            float(stream(seed, Stream.MODEL, robot).uniform(0.0, 2 * math.pi)) for robot in range(self.mission.n_robots)
        ]
        self.agents = list(self.possible_agents)
        self._advance()
        return self._observe(), {agent: {} for agent in self.agents}

    def step(
        self, actions: dict[str, Action]
    ) -> tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Give every robot its policy's answer, and go on to the next question, or the next round.

        Raises:
            InputError: an episode has not begun, or an agent that is in it has no action, or one of another shape.
        """
        trial = self._trial
        if trial is None or not self.agents:
            raise InputError("step", "called", "after reset, and until the episode is over")
        acting = list(self.agents)
        for agent in acting:
            if agent not in actions:
                raise InputError("actions", sorted(actions), f"an action for every agent; none for {agent}")
        rewards = dict.fromkeys(acting, 0.0)
        infos: dict[str, dict[str, Any]] = {agent: {} for agent in acting}
        ended = False
        if self._plans:
            answers = {k: self._plan_answer(k, actions[self.possible_agents[k]]) for k in self._plans}
            self._plans = {}
            trial.take_plans(answers)
            self._steps = trial.step_questions()
        else:
            answers = {k: self._step_answer(k, actions[self.possible_agents[k]]) for k in self._steps}
            ended = self._end_round(trial, answers, rewards, infos)
        if self.control == "questions":
            while not (ended or self._plans or self._steps):
                ended = self._end_round(trial, {}, rewards, infos)
        awake = {self.possible_agents[robot] for robot in trial.roster.awake}
        over = trial.round >= trial.rounds
        formed = trial.stopped == "formed"
        terminations = {agent: (ended and not over) or formed or agent not in awake for agent in acting}
        truncations = {agent: over and not terminations[agent] for agent in acting}
        observations = self._observe()
        self.agents = [agent for agent in acting if not (terminations[agent] or truncations[agent])]
        return observations, rewards, terminations, truncations, infos

    def render(self) -> NDArray[np.uint8] | None:
        """The team now, shape (height, width, 3); None without a render mode, or before the first episode."""
        if self.render_mode is None or self._trial is None or self._trial.journal.trace is None:
            return None
        from llm_flock_view._figures.animation import last_frame

        return np.asarray(last_frame(self.record()))

    def record(self) -> RunRecord:
        """The episode so far as a record in memory. Nothing in it comes from a language model.

        Raises:
            InputError: no episode has begun, or the environment does not render.
        """
        if self._trial is None or self._trial.journal.trace is None:
            raise InputError("record", "called", "after reset, with render_mode='rgb_array'")
        # Not "geometry", which stands for the models that are not asked.
        flown = self._config.model.model_copy(update={"model": f"policies ({self.control})"})
        return trace_record(self._config.model_copy(update={"model": flown}), self._trial.journal.trace)

    def state(self) -> NDArray[np.float64]:
        """True positions of all robots, shape (N * d,) [units; world frame]."""
        if self._trial is None:
            raise InputError("state", "called", "after reset")
        return self._trial.bodies.positions.ravel().copy()

    def _advance(self) -> None:
        """Begin the next round: find the robots that ask for a plan or, if none does, for a step."""
        trial = self._trial
        assert trial is not None
        self._plans, self._steps = trial.plan_questions(trial.round + 1), {}
        if self.control == "waypoints":
            trial.take_plans({r: geometric_plan(asked, self._angles[r]) for r, asked in self._plans.items()})
            self._plans = {}
        elif not self._plans:
            trial.take_plans({})
        if not self._plans:
            self._steps = trial.step_questions()

    def _end_round(
        self,
        trial: Trial,
        answers: Mapping[int, StepAnswer | NoAnswer],
        rewards: dict[str, float],
        infos: dict[str, dict[str, Any]],
    ) -> bool:
        """Move, and add to the rewards what the round has brought; begin the next round unless this was the last."""
        goals = {robot: trial.roster.agents[robot].goal for robot in trial.roster.awake}
        moves = trial.take_steps(answers)
        before = trial.bodies.positions.copy()
        self._readings.move(trial.displacements(moves))
        trial.end_round(trial.round + 1, moves)
        after = trial.bodies.positions
        near = _too_near(before, after, self.mission)
        ended = trial.find_end()
        for agent in rewards:
            robot = self.possible_agents.index(agent)
            goal, move = goals.get(robot), moves.get(robot)
            if goal is not None:
                gained = math.dist(before[robot], goal) - math.dist(after[robot], goal)
                rewards[agent] += gained / self.mission.max_step
            rewards[agent] += 10.0 * (trial.stopped == "formed") - 1.0 * (robot in near)
            infos[agent] = {"round": trial.round, "origin": None if move is None else move.origin.value}
        ended = ended or trial.round >= trial.rounds
        self._plans, self._steps = {}, {}
        if ended:
            for robot in trial.roster.awake:
                self._readings.sense(robot)
        else:
            self._advance()
        return ended

    def _plan_answer(self, robot: int, action: Action) -> PlanAnswer | NoAnswer:
        points = _numbers(action, "plan", (self.mission.n_places, self.mission.dim))
        points = points[: self._plans[robot].mission.n_places]  # fewer once robots have died and the team replans
        slot = float(_numbers(action, "slot", ()))
        if not np.isfinite(points).all():
            return NoAnswer(cause="answer", reason="the plan holds a number that is not finite")
        if slot not in range(len(points)):
            return NoAnswer(cause="answer", reason=f"there is no place {slot:g}")
        return PlanAnswer(plan=Plan.of(points.tolist()), slot=int(slot))

    def _step_answer(self, robot: int, action: Action) -> StepAnswer | NoAnswer:
        asked = self._steps[robot]
        if self.control == "questions":
            waypoint = _numbers(action, "waypoint", (self.mission.dim,))
        else:
            share = _numbers(action, None, (self.mission.dim,))
            waypoint = np.array(asked.position) + self.mission.max_step * share / max(1.0, float(np.linalg.norm(share)))
        if not np.isfinite(waypoint).all():
            return NoAnswer(cause="answer", reason="the waypoint holds a number that is not finite")
        return StepAnswer(waypoint=tuple(waypoint.tolist()))

    def _observe(self) -> dict[str, Observation]:
        assert self._trial is not None
        return {agent: self._observation(self._trial, self.possible_agents.index(agent)) for agent in self.agents}

    def _observation(self, trial: Trial, robot: int) -> Observation:
        mission, mind = self.mission, trial.roster.agents[robot]
        asked = self._steps.get(robot) or self._plans.get(robot)
        reading = self._readings.last[robot]
        seen = list(reading.sensed.values() if asked is None else asked.neighbors)
        neighbors = np.zeros((max(1, mission.n_robots - 1), mission.dim))
        neighbors[: len(seen)] = np.array(seen).reshape(-1, mission.dim)
        plan = np.zeros((mission.n_places, mission.dim))
        if mind.plan is not None:
            points = mind.plan.points[: mission.n_places]
            plan[: len(points)] = points
        goal = asked.goal if isinstance(asked, StepQuestion) else mind.goal
        slot = mind.claim.slot
        return {
            "asks": PLAN if robot in self._plans else STEP if robot in self._steps else NOTHING,
            "position": np.array(reading.position),
            "goal": np.zeros(mission.dim) if goal is None else np.array(goal),
            "has_goal": int(goal is not None),
            "neighbors": neighbors,
            "n_neighbors": len(seen),
            "plan": plan,
            "slot": mission.n_places if slot is None else slot,
        }

    def _observation_space(self) -> spaces.Space[Any]:
        mission = self.mission

        def box(*shape: int) -> spaces.Box:
            return spaces.Box(-np.inf, np.inf, shape, np.float64)

        return spaces.Dict(
            {
                "asks": spaces.Discrete(3),
                "position": box(mission.dim),
                "goal": box(mission.dim),
                "has_goal": spaces.Discrete(2),
                "neighbors": box(max(1, mission.n_robots - 1), mission.dim),
                "n_neighbors": spaces.Discrete(mission.n_robots),
                "plan": box(mission.n_places, mission.dim),
                "slot": spaces.Discrete(mission.n_places + 1),
            }
        )

    def _action_space(self) -> spaces.Space[Any]:
        mission = self.mission
        low, high = (np.array(corner, dtype=np.float64) for corner in mission.arena)
        if self.control == "waypoints":
            return spaces.Box(-1.0, 1.0, (mission.dim,), np.float64)
        places = (mission.n_places, 1)
        return spaces.Dict(
            {
                "plan": spaces.Box(np.tile(low, places), np.tile(high, places), dtype=np.float64),
                "slot": spaces.Discrete(mission.n_places),
                "waypoint": spaces.Box(low, high, dtype=np.float64),
            }
        )


def parallel_env(mission: Mission | None = None, **options: Any) -> FlockEnv:
    """The environment; takes what `FlockEnv` takes."""
    return FlockEnv(mission, **options)


class RememberedReadings(Readings):
    """Readings that keep each robot's last ones, since every new one has other errors."""

    def __init__(self, config: RunConfig, start: Points) -> None:
        given, rng = config.trial, stream(config.trial.seed, Stream.NOISE)
        errors = {"drift": given.drift, "delay": given.sensing_delay}
        super().__init__(config.mission, start, given.noise, rng, **errors, moving=given.moving_obstacles)
        self.last = [Sensing(position=tuple(place), sensed={}) for place in start.tolist()]

    def sense(self, robot: int) -> Sensing:
        """One robot's readings, with new errors at every call."""
        self.last[robot] = super().sense(robot)
        return self.last[robot]


def begin_trial(config: RunConfig, *, trace: bool) -> tuple[Trial, RememberedReadings]:
    """A trial of simulated bodies whose questions the caller answers; its start is recorded."""
    start = starts_of(config)
    readings = RememberedReadings(config, start)
    planners = TeamPlanners(config, CallLane(pool=ModelPool(environ={}, asks=False)))  # copies take no keys along
    journal = Journal(config, NullWriter(), trace=trace)
    trial = Trial(config, config.protocol.rules(), planners, InstantBodies(readings), journal, start)
    trial.begin()
    return trial, readings


def _numbers(action: Action, part: str | None, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """A part of an action, as numbers of this shape."""
    field = "action" if part is None else f"action[{part!r}]"
    try:
        found = np.asarray(action if part is None else action[part], dtype=np.float64)
    except (TypeError, ValueError, KeyError, IndexError):
        raise InputError(field, action, f"numbers of shape {shape}") from None
    if found.shape != shape:
        raise InputError(field, action, f"numbers of shape {shape}, not {found.shape}")
    return found


def _too_near(before: NDArray[np.float64], after: NDArray[np.float64], mission: Mission) -> set[int]:
    """Robots that were nearer to another than the safe distance while they moved."""
    limit = mission.safe_distance - ROUNDING
    before, after = flattened(before, mission.downwash), flattened(after, mission.downwash)
    if segment_separation(before, after) >= limit:
        return set()
    pairs = combinations(range(len(before)), 2)
    near = [pair for pair in pairs if segment_separation(before[[*pair]], after[[*pair]]) < limit]
    return {*chain.from_iterable(near)}
