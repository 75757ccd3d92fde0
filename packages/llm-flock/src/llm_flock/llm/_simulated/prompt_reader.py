"""Reads the packaged prompts, from which a simulated model learns everything."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import get_args

import numpy as np

from llm_flock import shapes as formations
from llm_flock.arrays import Point, Points, separation
from llm_flock.errors import InputError, ModelError
from llm_flock.llm._prompting import NOT_FLOWN, PromptSet
from llm_flock.mission import Mission
from llm_flock.obstacles import Obstacle, clearance
from llm_flock.plan import Plan
from llm_flock.planner import AIMS, JudgementOption, PlanQuestion, StepQuestion

_FLOAT = re.compile(r"[-+]?[0-9][0-9.]*(?:e[-+]?[0-9]+)?")
_TEAM = re.compile(r"in a team of ([0-9]+)")
_PLACES = re.compile(r"^- Places: ([0-9]+) ", re.MULTILINE)
_LINE = re.compile(r"^- ([A-Z][a-z ]+): (.*)$", re.MULTILINE)
_ROBOT = re.compile(r"You are robot ([0-9]+)")
_POLYGON = re.compile(r"a regular polygon with ([0-9]+) sides")
_ROUND = re.compile(r"of radius ([0-9.]+) around \[([^\]]+)\]")
_CORNERS = re.compile(r"with the corners \[((?:\[[^\]]+\],? ?)+)\]")
_CORNER = re.compile(r"\[([^\]]+)\]")
_STILL = re.compile(r"^Robots that do not move any more stand at (\[\[.+\]\]): ", re.MULTILINE)
_TURNED = ", turned in any direction; "
_GIVEN = "relative to its centre its places are [["
_LETTERS = "the letters "

_WAY = re.compile(r"\b([SHLRW]) (?:tight|wide|free)")

_OPTION = re.compile(
    r"^- ([a-z]+): .*Rounds: (\d+); flying: ([\d.]+) units; empty places: (\d+); robots lost: (\d+)\.$", re.MULTILINE
)
_AIM = re.compile("no robot may be lost; after that, (.*)")

JUDGEMENT_MARK = "Something has come up: "
WISH_MARK = "Wish: "
PLAN_MARK = "Work out a plan:"
STEP_MARK = "Your position: "
_JSON_MARK = "JSON object"
_PROGRAM_MARK = "draw the shape as a short program"
_POSITION = re.compile(rf"{STEP_MARK}(.*)")
_NEIGHBORS = re.compile(r"^Robots near you, moving as well: (.*)", re.MULTILINE)
_GOAL = re.compile(r"^Your goal, .*?: (.*)", re.MULTILINE)
_MARGIN = re.compile("nearer than ([0-9.]+)")
_ROW = re.compile(r"\[[^\[\]]+\]")
_HORIZON = re.compile(r"path of at most ([0-9]+) positions")


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """The content of the system message: the shape as text, lengths [units] and obstacles.

    `safe_distance` is for other robots, whose heights count divided by `downwash`, `clearance` for obstacles; 0 if the
    message has none.
    """

    shape: str
    n_places: int
    center: Point
    spacing: float
    max_step: float
    obstacles: tuple[Obstacle, ...] = ()
    clearance: float = 0.0
    safe_distance: float = 0.0
    downwash: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class StepPrompt:
    """The content of the position update; `horizon` is 1 if it asks for a single position."""

    task: Task
    position: Point
    goal: Point
    goal_text: str
    neighbors: str
    horizon: int
    json: bool
    objection: str

    def objected(self) -> tuple[float, list[tuple[Point, Point]]]:
        """Read the distance that was not kept, and the ways of the robots that it was not kept to."""
        points = [numbers(row) for row in _ROW.findall(self.objection)][2:]
        return float(_first_group(_MARGIN, self.objection)), [*zip(points[::2], points[1::2], strict=True)]

    def seen(self) -> list[Point]:
        """Read the positions of the other robots."""
        return _points(self.neighbors, len(self.position))

    @property
    def decimals(self) -> int:
        """Decimals of stated positions."""
        return sensible_decimals(self.task.max_step)

    @property
    def reach(self) -> float:
        """Longest stated step: the step limit minus the largest rounding error of the printed position."""
        return self.task.max_step - max(1e-6, 10.0 ** -(self.decimals + 1))

    def towards(self, target: Point) -> Point:
        """A full step towards a target, each coordinate rounded back towards the own position."""
        share, scale = self.reach / math.dist(self.position, target), 10**self.decimals
        return tuple(
            (math.floor if t > x else math.ceil)((x + share * (t - x)) * scale) / scale
            for x, t in zip(self.position, target, strict=True)
        )

    def rounded(self, point: Sequence[float]) -> str:
        """A position as it is stated."""
        return repr([round(x, self.decimals) for x in point])

    def stated(self, path: Sequence[str]) -> str:
        """Waypoints in the form that the prompt asks for."""
        if self.horizon == 1:
            return f'{{"position": {path[0]}}}' if self.json else f"Position: {path[0]}"
        rows = ", ".join(path)
        return f'{{"path": [{rows}]}}' if self.json else f"Path: [{rows}]"


def _points(text: str, dim: int) -> list[Point]:
    """All points of a text, in order."""
    values = numbers(text)
    return [values[i : i + dim] for i in range(0, len(values), dim)]


def numbers(text: str) -> Point:
    """All numbers of a text, in order."""
    return tuple(map(float, _FLOAT.findall(text)))


@lru_cache(maxsize=64)
def sensible_decimals(length: float) -> int:
    """Decimals of stated numbers: two, or more if lengths are below one unit."""
    return max(2, 2 - math.floor(math.log10(length)))


@lru_cache(maxsize=64)
def read_task(system: str) -> Task:
    """Read the system message; InputError if it is not in the packaged words."""
    team, lines = _PLACES.search(system) or _TEAM.search(system), dict(_LINE.findall(system))
    center = numbers(lines.get("Centre of the shape", ""))
    spacing, max_step = numbers(lines.get("Spacing", "")), numbers(lines.get("Step limit", ""))
    if team is None or "Shape" not in lines or not (center and spacing and max_step):
        raise _other_words("system.j2", system)
    obstacles = lines.get("Obstacles", "")
    apart, _, by_height = lines.get("Safe distance", "").partition("divided by")
    return Task(
        shape=lines["Shape"],
        n_places=int(team[1]),
        center=center,
        spacing=spacing[0],
        max_step=max_step[0],
        obstacles=_obstacles(obstacles),
        clearance=next(iter(numbers(obstacles)), 0.0),
        safe_distance=next(iter(numbers(apart)), 0.0),
        downwash=next(iter(numbers(by_height)), 1.0),
    )


def _obstacles(text: str) -> tuple[Obstacle, ...]:
    """The obstacles of their line in the system message."""
    round_ones = [Obstacle(radius=float(radius), center=numbers(at)) for radius, at in _ROUND.findall(text)]
    corners = [[numbers(corner) for corner in _CORNER.findall(rows)] for rows in _CORNERS.findall(text)]
    return (*round_ones, *(Obstacle(polygon=tuple((x, y) for x, y in rows)) for rows in corners))


def read_plan(text: str) -> tuple[int, bool]:
    """Read the robot's id in the plan message, and whether the answer is to be JSON; InputError as in `read_task`."""
    robot = _first_group(_ROBOT, text)
    if not robot:
        raise _other_words("plan.j2", text)
    return int(robot), _JSON_MARK in text


def asks_for_program(text: str) -> bool:
    """Whether a question for a plan wants a formation program."""
    return _PROGRAM_MARK in text


def read_judgement(text: str) -> tuple[list[JudgementOption], str, bool]:
    """Read the options of a judgement, what counts, and whether the answer is to be JSON; InputError as in `read_task`.

    Raises:
        ModelError: `refused`, for a wish in free words.
    """
    found, aim = _OPTION.findall(text), _first_group(_AIM, text)
    if not found or not aim:
        raise _other_words("judgement.j2", text)
    if aim not in AIMS and aim.partition(":")[0] not in [name for name, *_ in found]:
        raise ModelError("refused", f"a simulated model cannot read the wish {aim[:80]!r}")
    options = [
        JudgementOption(choice=name, does="", rounds=int(a), distance=float(b), gaps=int(c), lost=int(d))
        for name, a, b, c, d in found
    ]
    return options, aim, _JSON_MARK in text


def read_still(text: str, dim: int) -> list[Point]:
    """Read the positions of robots that stand still from the plan message; empty if it names none."""
    return _points(_first_group(_STILL, text), dim)


def read_step(text: str, task: Task) -> StepPrompt:
    """Read the position update, without the plan in it; InputError if it is not in the packaged words."""
    goal_text = _first_group(_GOAL, text)
    position, goal = numbers(_first_group(_POSITION, text)), numbers(goal_text)
    if not position or len(goal) != len(position):
        raise _other_words("step.j2", text)
    return StepPrompt(
        task=task,
        position=position,
        goal=goal,
        goal_text=goal_text,
        neighbors=_first_group(_NEIGHBORS, text),
        horizon=int(_first_group(_HORIZON, text) or 1),
        json=_JSON_MARK in text,
        objection=text.partition(NOT_FLOWN)[2],
    )


def read_ways(text: str) -> list[str]:
    """Read the letters of the ways, in order; empty if the question is not for a letter."""
    return _WAY.findall(text.rpartition("\n")[2]) if text.startswith(WISH_MARK) else []


def check_prompts(prompts: PromptSet, mission: Mission) -> None:
    """Read the prompts of sample questions, before a run with simulated models; InputError as in `read_task`."""
    if prompts.letters:
        return
    task = read_task(prompts.system(mission))
    here, plan = mission.center, Plan.of([mission.center] * mission.n_places)
    read_plan(prompts.plan(PlanQuestion(mission=mission, robot=0, round=1, position=here, neighbors=())))
    step = StepQuestion(mission=mission, robot=0, round=1, position=here, neighbors=(), plan=plan, slot=0)
    read_step(prompts.step(step), task)


def _first_group(pattern: re.Pattern[str], text: str) -> str:
    """The text of the group of a pattern, empty without a match."""
    match = pattern.search(text)
    return "" if match is None else match[1]


def _other_words(template: str, text: str) -> InputError:
    return InputError("prompts", text[:80], f"{template} in the packaged words: simulated models understand no others")


@lru_cache(maxsize=64)
def formation(task: Task) -> Points:
    """Ideal points of the task's shape, shape (n, d) [units]; do not change them.

    Raises:
        ModelError: `refused`, for a shape in free text, which a stand-in cannot read.
    """
    center, n = task.center, task.n_places
    if _GIVEN in task.shape:
        rows = np.array(numbers(task.shape.partition(_GIVEN)[2])).reshape(n, len(center))
        points = formations.ideal_points("points", n, center, task.spacing, rows.tolist())
    else:
        spec = _spec(task.shape)
        if spec is None:
            raise ModelError("refused", f"a simulated model cannot read words: it draws no {task.shape[:80]!r}")
        points = formations.ideal_points(spec, n, center[:2], task.spacing)
    assert points is not None, "only free text has no ideal points"
    if points.shape[1] < len(center):
        height = np.full((n, len(center) - 2), center[2:])
        points = np.hstack([points, height])
    points.setflags(write=False)
    return points


def named_figure(task: Task) -> dict[str, object]:
    """The element of a formation program that draws the task's named shape.

    Raises:
        ModelError: `refused`, for other shapes, of which a stand-in knows no drawing.
    """
    from llm_flock.formation._program import SPACE, Flat

    words = task.shape.partition(_TURNED)[0]
    if words.startswith(_LETTERS):
        return {"text": words.removeprefix(_LETTERS)}
    name, _, sides = (_spec(words) or "").partition(":")
    name = next((solid for solid in SPACE if formations.describe(solid) == words), name)
    if name not in (*get_args(Flat), *SPACE):
        raise ModelError("refused", f"a simulated model draws named shapes only, not {task.shape[:80]!r}")
    figure: dict[str, object] = {"shape": name}
    return figure | ({"sides": int(sides)} if sides else {})


def other_figures(figure: Mapping[str, object]) -> list[dict[str, object]]:
    """The named outlines of the plane that are not this one, from the one that follows it in the list."""
    from llm_flock.formation._program import Flat

    names = [name for name in get_args(Flat) if name not in ("polygon", "grid")]
    at = names.index(str(figure.get("shape"))) if figure.get("shape") in names else -1
    return [{"shape": name} for name in (*names[at + 1 :], *names[: max(at, 0)])]


def is_clear(points: Points, task: Task, still: Sequence[Point]) -> bool:
    """Whether all places, shape (n, d) [units], are far enough from obstacles, and from robots that stand still."""
    return all(
        clearance(tuple(row), task.obstacles) >= task.clearance
        and all(separation(tuple(row), body, task.downwash) >= task.safe_distance for body in still)
        for row in points.tolist()
    )


def _spec(words: str) -> str | None:
    """The named shape that has this description; None for other words."""
    polygon = _POLYGON.match(words)
    if polygon is not None:
        return f"polygon:{polygon[1]}"
    plain = (info.name for info in formations.shapes() if info.layout and ":" not in info.name)
    return next((name for name in plain if formations.describe(name) == words), None)
