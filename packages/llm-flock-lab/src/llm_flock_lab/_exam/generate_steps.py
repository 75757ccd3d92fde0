"""Make questions for steps and paths: distances, others beside or in the way, walls, obstacles, limits."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from llm_flock.arrays import Point
from llm_flock.errors import InputError
from llm_flock.mission import Mission, build_mission
from llm_flock.obstacles import nearest_on_segment
from llm_flock.planner import PlanAnswer, StepAnswer
from llm_flock.protocol import HORIZON, geometric_plan, step_faults
from llm_flock_lab._exam.draws import (
    STEP_TEAMS,
    away,
    direction,
    draw_fields,
    draw_plan,
    inside,
    lattice,
    round_point,
    rounded_rows,
    try_mission,
    unit,
)
from llm_flock_lab._exam.generate_plans import among_obstacles
from llm_flock_lab._exam.questions import Question

STEPS_EACH = 16  # questions for steps of each kind

OTHERS_STEPS, OTHERS_PLANS = 16, 8
PATHS = 24

DISTANCES: dict[str, tuple[float, float]] = {
    "near": (0.08, 0.95),
    "far": (1.1, 12.0),
    "beside": (0.3, 6.0),
    "wall": (0.3, 4.0),
    "obstacle": (0.5, 6.0),
    "limit": (0.97, 1.03),
    "small": (0.1, 6.0),
    "space": (0.2, 6.0),
}
"""Kinds of steps, and the distances of their goals [step limits]."""

STILL_TEAMS = (("circle", 5), ("line", 4), ("square", 4), ("wedge", 5), ("grid", 6), ("triangle", 6))
"""Teams whose reference orientation has a robot that stands still on one of its places."""


def step_questions(rng: np.random.Generator) -> Iterator[Question]:
    """`STEPS_EACH` questions of every kind in `DISTANCES`; the straight step is a good answer to each."""
    for kind, (least, most) in DISTANCES.items():
        for number in range(STEPS_EACH):
            # Distances are spread evenly over their logarithm, and not left to chance.
            share = (number + float(rng.uniform())) / STEPS_EACH
            distance = least * (most / least) ** share
            yield draw_step(rng, kind, STEP_TEAMS[number % len(STEP_TEAMS)], distance)


def others_questions(rng: np.random.Generator) -> Iterator[Question]:
    """Steps whose straight way is blocked by a robot, and plans whose reference orientation is."""
    for number in range(OTHERS_STEPS):
        distance = float(rng.uniform(0.6, 5.0))
        yield draw_step(rng, "ahead", STEP_TEAMS[number % len(STEP_TEAMS)], distance, section="others")
    for number in range(OTHERS_PLANS):
        yield _still_plan(rng, *STILL_TEAMS[number % len(STILL_TEAMS)])


def path_questions(rng: np.random.Generator) -> Iterator[Question]:
    """Paths of at most `HORIZON` positions, to goals of up to 18 step limits away."""
    for number in range(PATHS):
        distance = 0.5 * 36 ** ((number + float(rng.uniform())) / PATHS)
        kind = ("far", "beside", "small")[number % 3]
        question = draw_step(rng, kind, STEP_TEAMS[number % len(STEP_TEAMS)], distance)
        yield replace(question, section="path", horizon=HORIZON)


def draw_step(
    rng: np.random.Generator, kind: str, team: tuple[str, int], distance: float, section: str = "step"
) -> Question:
    """A question of a kind, drawn again until it is what the kind says; `distance` is that of the goal."""
    while True:
        question = _try_step(rng, kind, team, distance, section)
        if question is not None:
            return question


def _try_step(
    rng: np.random.Generator, kind: str, team: tuple[str, int], distance: float, section: str
) -> Question | None:
    fields = _fields(rng, kind, team)
    mission = try_mission(fields)
    if mission is None:
        return None
    plan = rounded_rows(draw_plan(rng, mission), mission.spacing)
    slot = int(rng.integers(len(plan)))
    here = round_point(away(plan[slot], distance * mission.max_step, direction(rng, mission.dim)), mission.spacing)
    corner: Point | None = None
    if kind == "obstacle":
        assert mission.roadmap is not None
        stop = mission.roadmap.next_stop(here, plan[slot])
        corner = None if stop == plan[slot] else round_point(stop, mission.spacing)
    if not inside(mission, here):
        return None
    if kind == "wall" and _to_wall(mission, plan[slot]) > mission.max_step:
        return None
    goal = plan[slot] if corner is None else corner
    if math.dist(here, goal) < 0.05 * mission.max_step:
        return None
    question = Question(
        id="",
        section=section,
        n=len(plan),
        tags=(kind,),
        distance=round(math.dist(here, goal) / mission.max_step, 3),
        mission=fields,
        robots=(slot,),
        position=here,
        neighbors=_neighbors(rng, kind, mission, here, goal),
        plan=plan,
        slot=slot,
        corner=corner,
    )
    return question if _is_as_said(question, mission, kind) else None


def _fields(rng: np.random.Generator, kind: str, team: tuple[str, int]) -> dict[str, Any]:
    shape, n = team
    if kind == "space":
        return draw_fields(rng, "points", n, points=lattice(rng, n, 3), dim=3)
    fields = draw_fields(rng, shape, n, small=kind == "small", tight=kind == "wall")
    return among_obstacles(rng, fields) if kind == "obstacle" else fields


def _to_wall(mission: Mission, point: Point) -> float:
    low, high = mission.arena
    return min(min(x - a, b - x) for a, x, b in zip(low, point, high, strict=True))


def _neighbors(rng: np.random.Generator, kind: str, mission: Mission, here: Point, goal: Point) -> tuple[Point, ...]:
    """The robots that this one sees: on its way, beside it, or one or two anywhere."""
    end = _straight_end(mission, here, goal)
    safe, length = mission.safe_distance, mission.spacing
    if kind == "ahead":
        return (round_point(away(end, float(rng.uniform(0.0, 0.6)) * safe, direction(rng, mission.dim)), length),)
    wanted = int(rng.integers(1, 4)) if kind == "beside" else int(rng.choice([0, 0, 1, 2]))
    found: list[Point] = []
    while len(found) < wanted:
        reach = (1.15 * safe, 2.0 * safe) if kind == "beside" else (1.5 * safe, mission.sensing)
        base = away(here, float(rng.uniform(0.0, 1.0)) * math.dist(here, end), unit(here, end))
        other = round_point(away(base, float(rng.uniform(*reach)), direction(rng, mission.dim)), length)
        if math.dist(nearest_on_segment(other, here, end), other) > 1.1 * safe and all(
            math.dist(other, one) > safe for one in found
        ):
            found.append(other)
    return tuple(found)


def _straight_end(mission: Mission, here: Point, goal: Point) -> Point:
    return away(here, min(mission.max_step, math.dist(here, goal)), unit(here, goal))


def _is_as_said(question: Question, mission: Mission, kind: str) -> bool:
    """Whether the straight step is right, or for a robot ahead: wrong, while another one is right."""
    asked = question.step_question(mission, 0)
    end = _straight_end(mission, asked.position, asked.goal)
    fine = not step_faults(asked, end)
    if kind != "ahead":
        clear = all(o.segment_distance(asked.position, end) >= mission.body_radius for o in mission.obstacles)
        return fine and clear and all(inside(mission, other) for other in question.neighbors)
    if fine or math.dist(asked.position, question.neighbors[0]) < 1.02 * mission.safe_distance:
        return False
    return sidestep(question, mission) is not None


def sidestep(question: Question, mission: Mission) -> StepAnswer | None:
    """A step to show that a question can be answered: accepted and nearer to the goal, straight or aside; else None."""
    asked = question.step_question(mission, 0)
    here, goal = asked.position, asked.goal
    angle = math.atan2(goal[1] - here[1], goal[0] - here[0])
    longest = min(mission.max_step, math.dist(here, goal))
    for turn in (0, 15, -15, 30, -30, 45, -45, 60, -60, 75, -75):
        for share in (1.0, 0.75, 0.5, 0.25):
            at = angle + math.radians(turn)
            aside = (share * longest * math.cos(at), share * longest * math.sin(at), *(0.0,) * (mission.dim - 2))
            waypoint = tuple(x + d for x, d in zip(here, aside, strict=True))
            nearer = math.dist(waypoint, goal) < math.dist(here, goal)
            if nearer and not step_faults(asked, waypoint):
                return StepAnswer(waypoint=waypoint)
    return None


def _still_plan(rng: np.random.Generator, shape: str, n: int) -> Question:
    """A plan with a robot standing still on a place of the reference orientation; another orientation is possible."""
    while True:
        fields = draw_fields(rng, shape, n)
        mission = build_mission(**fields)
        assert mission.ideal is not None
        body = round_point(mission.ideal[int(rng.integers(n))], mission.spacing)
        robot = int(rng.integers(n))
        question = Question(
            id="", section="others", n=n, tags=("still", shape), mission=fields, robots=(robot,), still=(body,)
        )
        try:
            answer = geometric_plan(question.plan_question(mission, robot, 0))
        except InputError:
            continue
        if isinstance(answer, PlanAnswer):
            return question
