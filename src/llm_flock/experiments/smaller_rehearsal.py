"""Forecasts the use of a large team from a small one of the same shape: its own rehearsal would take minutes."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from llm_flock import formations, metrics
from llm_flock.errors import InputError
from llm_flock.llm.models import parse_history, parse_models
from llm_flock.llm.prompt_values import place_text
from llm_flock.llm.prompting import PromptSet
from llm_flock.llm.sharing import CHARS_PER_TOKEN
from llm_flock.mission import Mission, build_mission
from llm_flock.protocol.plan import Plan
from llm_flock.protocol.planning import PlanQuestion, StepQuestion
from llm_flock.robots.simulated import draw_start
from llm_flock.runtime.api import run
from llm_flock.runtime.config import ModelConfig, RunConfig
from llm_flock.runtime.seeds import Stream, stream
from llm_flock.runtime.trial import TrialProgress

LARGE = 150
"""Largest team that is rehearsed itself [robots]."""

SIZES = range(32, 11, -1)
"""Sizes of the team that flies instead; the first one that the shape takes is used [robots]."""

ROUNDS = 40
"""Rounds that the small team flies where a run does not end when the formation is held."""

LONGEST_S = 10.0
"""A rehearsal of a small team stops after this time of the processor, which does not depend on other programs [s]."""

CROWDS = (48, 100)
"""Teams that fly without a model, to see how much crowding costs; the next smaller one of the shape [robots]."""

CROWD_S = 15.0
"""Longest flight of one of them [s of the processor]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TeamUse:
    """What a team uses, as `sweep_forecast.Expected` has it, and the rounds that it flies."""

    calls: float
    tokens_input: float
    tokens_output: float
    rounds: float
    wall_s: float


def smaller_team(config: RunConfig) -> RunConfig | None:
    """A small team with the rules, density and model of a large one; None for a team that has to fly itself.

    The arena shrinks with the formation. Obstacles, deaths, joins and other missions in flight are left out. Shapes
    without known points or of the user's own, spare robots, models that differ and kept history are not scaled.
    """
    mission, model = config.mission, config.model
    scales = mission.ideal is not None and mission.shape != "points" and mission.n_places == mission.n_robots
    if not scales or parse_history(model.history) != 0 or len(set(parse_models(model.model, mission.n_robots))) > 1:
        return None
    return _calm_team(config, [n for n in SIZES if 2 * n <= mission.n_robots])


def _calm_team(config: RunConfig, sizes: Iterable[int]) -> RunConfig | None:
    """The team of the first of these sizes that the shape takes, without what happens to the large one in flight."""
    small = next((found for n in sizes if (found := _of_size(config.mission, n)) is not None), None)
    if small is None:
        return None
    rounds = None if config.trial.stop_when_formed else min(ROUNDS, config.most_rounds)
    calm = {"kill": None, "join": None, "kill_random": 0, "join_random": 0, "changes": (), "rounds": rounds}
    calm |= {"start_positions": None, "start_area": None, "out": None}
    return config.model_copy(update={"mission": small, "trial": config.trial.model_copy(update=calm)})


def _of_size(mission: Mission, n: int) -> Mission | None:
    """The mission for n robots at the density of this one; None where it is not allowed."""
    given = mission.model_dump(exclude_unset=True, exclude={"arena", "obstacles"}) | {"n_robots": n}
    try:
        places = formations.ideal_points(mission.shape, n, mission.center, mission.spacing)
        if places is None or mission.ideal is None:
            return None
        reach, whole = (formations.circumradius(np.array(rows), mission.center) for rows in (places, mission.ideal))
        share = max(reach / whole, (n / mission.n_robots) ** (1 / mission.dim))
        arena = [[c + share * (x - c) for x, c in zip(corner, mission.center, strict=True)] for corner in mission.arena]
        return build_mission(**given, arena=arena)
    except InputError:
        return None


class _LongEnough(Exception):
    """A rehearsal takes too long."""


def rehearse_small(config: RunConfig) -> tuple[TeamUse, float]:
    """What a small team uses, and how many of its calls belong to the first round, with its plans."""
    began = time.process_time()
    seen: list[TrialProgress] = []

    def note(now: TrialProgress) -> None:
        seen.append(now)
        if time.process_time() - began > LONGEST_S:
            raise _LongEnough

    with suppress(_LongEnough):
        found = run(config=config, on_round=note, progress=False, trace=False).summary.to_dict()
        use = TeamUse(
            calls=found["model_calls"],
            tokens_input=found["tokens_input"],
            tokens_output=found["tokens_output"],
            rounds=found["rounds"],
            wall_s=found["wall_s"],
        )
        return use, seen[0].model_calls if seen else 0.0
    first, now = seen[0], seen[-1]
    later = (now.rounds - first.round) / max(1, now.round - first.round)
    calls = first.model_calls + (now.model_calls - first.model_calls) * later
    tokens = first.tokens + (now.tokens - first.tokens) * later
    use = TeamUse(calls=calls, tokens_input=tokens, tokens_output=0.0, rounds=now.rounds, wall_s=LONGEST_S * later)
    return use, first.model_calls


def crowding(config: RunConfig, small: RunConfig) -> float:
    """How many times the rounds per lower bound of a small team a large one needs, as robots wait for each other.

    Teams of growing size fly without a model, which costs little and takes as many rounds as with good answers. What is
    larger than the largest of them is taken to go on as from the small team to that one: as a power of the size.
    """
    n, few = config.mission.n_robots, small.mission.n_robots
    base = _ratio_without_model(small)
    size, found = few, base
    for goal in CROWDS:
        team = _calm_team(config, range(min(goal, n), few, -1))
        if base is None or team is None or team.mission.n_robots <= size:
            break
        ratio = _ratio_without_model(team)
        if ratio is None:
            break
        size, found = team.mission.n_robots, ratio
    if base is None or found is None or size == few:
        return 1.0
    power = math.log(found / base) / math.log(size / few)
    return max(1.0, (n / few) ** power)


def _ratio_without_model(team: RunConfig) -> float | None:
    """Rounds until a team has formed, by their lower bound; None if it does not form, or takes too long."""
    began = time.process_time()

    def note(_: TrialProgress) -> None:
        if time.process_time() - began > CROWD_S:
            raise _LongEnough

    team = team.model_copy(update={"model": ModelConfig(model="geometry")})
    with suppress(_LongEnough):
        rounds = run(config=team, on_round=note, progress=False, trace=False).summary.rounds_to_formed
        return None if rounds is None else max(1, rounds) / max(1, _bound(team))
    return None


def scaled(config: RunConfig, small: RunConfig, use: TeamUse, first: float) -> TeamUse:
    """The use of a large team from that of a small one.

    Each robot makes as many calls in the first round, and as many in each later one. Rounds grow as their lower bound
    does, and by crowding. One prompt and one answer of each kind are written for the large team, which tells how much
    longer they are.
    """
    n, few = config.mission.n_robots, small.mission.n_robots
    if not use.calls:
        return TeamUse(calls=0.0, tokens_input=0.0, tokens_output=0.0, rounds=use.rounds, wall_s=use.wall_s)
    rounds = float(config.most_rounds)
    if config.trial.stop_when_formed:
        rounds = min(rounds, use.rounds * crowding(config, small) * _bound(config) / max(1, _bound(small)))
    per_round = (use.calls - first) / max(1.0, use.rounds - 1)
    calls = (first + per_round * max(0.0, rounds - 1)) * n / few
    one, other = _Lengths.of(config), _Lengths.of(small)
    steps = max(1.0, use.calls - few)  # each robot asks for one plan
    step_in = max(0.0, use.tokens_input - few * other.plan) / steps + one.step - other.step
    step_out = max(0.0, use.tokens_output - few * other.answer) / steps
    return TeamUse(
        calls=calls,
        tokens_input=n * one.plan + max(0.0, calls - n) * step_in,
        tokens_output=0.0 if not use.tokens_output else n * one.answer + max(0.0, calls - n) * step_out,
        rounds=rounds,
        wall_s=use.wall_s * calls / use.calls,
    )


def _bound(config: RunConfig) -> int:
    """Lower bound of the rounds from a start to the shape as it is not turned."""
    mission, trial = config.mission, config.trial
    start = trial.start_positions
    if start is None:
        start = draw_start(mission, trial.start, stream(trial.seed, Stream.START), trial.start_area)
    assert mission.ideal is not None, "only teams with known points are scaled"
    within = metrics.AT_GOAL * mission.spacing
    return metrics.lower_bound_rounds(np.array(start), np.array(mission.ideal), mission.max_step, within=within)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Lengths:
    """Lengths of one prompt of each kind, system message included, and of one answer with a plan [tokens]."""

    plan: float
    step: float
    answer: float

    @classmethod
    def of(cls, config: RunConfig) -> _Lengths:
        mission = config.mission
        assert mission.ideal is not None, "only teams with known points are scaled"
        prompts = PromptSet.load(config.model.prompts or "full", json=config.model.answers == "json")
        robot = mission.n_robots // 2
        asked = PlanQuestion(mission=mission, robot=robot, round=1, position=mission.center, neighbors=(), still=())
        step = StepQuestion(
            mission=mission,
            robot=robot,
            round=1,
            position=mission.center,
            neighbors=(),
            plan=Plan.of(mission.ideal),
            slot=robot,
        )
        system = len(prompts.system(mission))
        return cls(
            plan=math.ceil((system + len(prompts.plan(asked))) / CHARS_PER_TOKEN),
            step=math.ceil((system + len(prompts.step(step))) / CHARS_PER_TOKEN),
            answer=sum(len(place_text(place)) + 2 for place in mission.ideal) / CHARS_PER_TOKEN,
        )
