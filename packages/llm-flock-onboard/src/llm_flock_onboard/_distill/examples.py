"""Make, write and read examples: questions with the answers of our own planner, for a small model.

Missions, positions and goals are random, the question goes through the frame and the prompts of a run, and the answer
is the straight step. Answers that our own checks would reject are not taught.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from llm_flock.arrays import Point
from llm_flock.errors import InputError
from llm_flock.llm import PromptSet, frame_plan, frame_step, place_text
from llm_flock.mission import Mission, build_mission
from llm_flock.plan import Plan
from llm_flock.planner import PlanAnswer, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.protocol import HORIZON, check_plan, geometric_plan, judge, straight_path
from llm_flock_onboard._distill.wishes import Split

DECIMALS = 2
"""Decimals in an answer: few tokens to learn and to generate, and still exact plans."""

REACH = 0.92
"""Length of a full step in step limits: an error of one or two in the last digit stays within the limit."""

PATHS = 0.15
"""Share of motion questions that ask for a path."""

TEAMS: tuple[tuple[str, tuple[int, ...]], ...] = (
    ("triangle", (3,)),
    ("square", (4,)),
    ("cross", (5,)),
    ("circle", (5, 10)),
)
"""Shapes and numbers of places of the taught plans."""

HELD_OUT_TEAMS: tuple[tuple[str, tuple[int, ...]], ...] = (("star", (10,)), ("wedge", (3, 5, 7, 8)))
"""Held-out teams, whose motion is never taught; held-out centres and spacings differ too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Example:
    """One question as the model sees it (two messages), and the answer to learn; `team` is as in `circle 5`."""

    kind: Literal["plan", "step", "path", "choice"]
    system: str
    user: str
    answer: str
    team: str


def draw_mission(rng: np.random.Generator, split: Split, teams: Sequence[tuple[str, tuple[int, ...]]]) -> Mission:
    """Draw a mission; centres and spacings of the two splits come from disjoint intervals."""
    shape, sizes = teams[int(rng.integers(len(teams)))]
    n = int(rng.choice(sizes))
    if split == "train":
        spacing, center = rng.uniform(9.0, 14.0), rng.uniform(30.0, 70.0, 2)
    else:
        spacing, center = rng.uniform(14.5, 18.0), rng.uniform(75.0, 90.0, 2)
    return build_mission(
        shape=shape,
        n_robots=n,
        center=tuple(map(float, center.round(2))),
        spacing=round(float(spacing), 2),
        max_step=float(rng.choice([4.0, 5.0, 6.0, 6.0, 6.0, 7.0])),
        arena=((-200.0, -200.0), (300.0, 300.0)),
    )


def draw_step(rng: np.random.Generator, mission: Mission) -> StepQuestion:
    """Draw a robot heading for its place, with or without others around it."""
    assert mission.ideal is not None, "only shapes whose points are known are drawn"
    slot = int(rng.integers(mission.n_places))
    goal = mission.ideal[slot]
    # A third of the robots can reach their place, as in a run; the others are near or far.
    share = rng.random()
    distance = (
        rng.uniform(0.0, 1.0) if share < 0.3 else rng.uniform(1.0, 3.0) if share < 0.65 else rng.uniform(3.0, 14.0)
    )
    angle = rng.uniform(0.0, 2 * math.pi)
    here = _away(goal, distance * mission.max_step, angle)
    crowd = int(rng.choice([0, 0, 0, 0, 0, 0, 0, 1, 2, 3]))
    reach = mission.safe_distance, mission.comm_range
    neighbors = tuple(_away(here, rng.uniform(*reach), rng.uniform(0.0, 2 * math.pi)) for _ in range(crowd))
    horizon = HORIZON if rng.random() < PATHS else 1
    return StepQuestion(
        mission=mission,
        robot=slot,
        round=1,
        position=here,
        neighbors=neighbors,
        plan=Plan.of(mission.ideal),
        slot=slot,
        horizon=horizon,
    )


def step_example(prompts: PromptSet, question: StepQuestion) -> Example | None:
    """A question with the straight step, rounded as in an answer; None where our own checks would reject it.

    Where a path is asked for, it has one position: each takes as long to generate as the first, and needs addition.
    """
    asked = frame_step(question, "own")
    mission = asked.framed.mission
    shorter = mission.model_copy(update={"max_step": REACH * mission.max_step})
    waypoint = _round_point(straight_path(replace(asked.framed, mission=shorter)).waypoint)
    # The shield takes care of the others, better than a small model would.
    alone = replace(question, neighbors=())
    if judge(alone, asked.to_world(StepAnswer(waypoint=waypoint)), shield_on=True).reason is not None:
        return None
    text, one = place_text(waypoint), question.horizon == 1
    return Example(
        kind="step" if one else "path",
        system=prompts.system(mission),
        user=prompts.step(asked.framed),
        answer=f"Position: {text}" if one else f"Path: [{text}]",
        team=f"{question.mission.shape} {question.mission.n_places}",
    )


def plan_example(prompts: PromptSet, mission: Mission, robot: int) -> Example | None:
    """As `step_example`, with the shape in its reference orientation."""
    question = PlanQuestion(mission=mission, robot=robot, round=1, position=mission.center, neighbors=())
    asked = frame_plan(question, "own")
    answer = geometric_plan(asked.framed)
    assert isinstance(answer, PlanAnswer), "only shapes whose points are known are drawn"
    answer = replace(answer, plan=Plan.of(map(_round_point, answer.plan.points)))
    if check_plan(mission, asked.to_world(answer).plan) is not None:
        return None
    places = ", ".join(map(place_text, answer.plan.points))
    return Example(
        kind="plan",
        system=prompts.system(asked.framed.mission),
        user=prompts.plan(asked.framed),
        answer=f"Plan: [{places}]\nmy plan: {answer.slot}",
        team=f"{mission.shape} {mission.n_places}",
    )


def motion_examples(seed: int, count: int, split: Split) -> Iterator[Example]:
    """Make `count` examples of steps and paths over random missions."""
    rng, prompts = np.random.default_rng([seed, split == "train"]), PromptSet.load("brief")
    teams = TEAMS if split == "train" else HELD_OUT_TEAMS
    drawn = (step_example(prompts, draw_step(rng, draw_mission(rng, split, teams))) for _ in itertools.count())
    return itertools.islice(filter(None, drawn), count)


def plan_examples(seed: int, split: Split) -> Iterator[Example]:
    """Make an example of every robot's question for a plan, for every taught team, at random centres and spacings."""
    rng, prompts = np.random.default_rng([seed, split == "train", 1]), PromptSet.load("brief")
    for shape, sizes in TEAMS:
        for n in sizes:
            mission = draw_mission(rng, split, ((shape, (n,)),))
            for robot in range(n):
                example = plan_example(prompts, mission, robot)
                if example is not None:
                    yield example


def write_examples(path: Path, examples: Iterable[Example]) -> int:
    """Write examples as JSON lines and return their number; InputError if the file cannot be written."""
    lines = [json.dumps(asdict(example)) + "\n" for example in examples]
    try:
        path.write_text("".join(lines), encoding="utf-8")
    except OSError as error:
        raise InputError("out", str(path), f"a file that can be written ({error.strerror})") from None
    return len(lines)


def read_examples(path: Path) -> list[Example]:
    """Read what `write_examples` wrote; InputError for field `data` if a line is not an example."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("data", str(path), f"a file of examples that can be read ({error})") from None
    examples: list[Example] = []
    for number, line in enumerate(lines, start=1):
        try:
            examples.append(Example(**json.loads(line)))
        except (TypeError, ValueError, RecursionError) as error:
            allowed = f"an example as `distill data` writes it ({error})"
            raise InputError("data", f"{path}, line {number}", allowed) from None
    if not examples:
        raise InputError("data", str(path), "a file with at least one example")
    return examples


def _away(point: Point, distance: float, angle_rad: float) -> Point:
    return point[0] + distance * math.cos(angle_rad), point[1] + distance * math.sin(angle_rad)


def _round_point(point: Point) -> Point:
    return tuple(round(x, DECIMALS) + 0.0 for x in point)
