"""Make questions that go on from an earlier answer: one that was rejected, or an own plan that was not adopted."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from llm_flock.arrays import Point, Points
from llm_flock.mission import Mission, build_mission
from llm_flock.plan import Plan
from llm_flock.protocol import check_proposal, step_faults
from llm_flock_lab._exam.draws import STEP_TEAMS, away, draw_fields, draw_plan, round_point, rounded_rows, unit
from llm_flock_lab._exam.generate_steps import draw_step, sidestep
from llm_flock_lab._exam.questions import Question
from llm_flock_lab._exam.score import shortfall

RETRIES_EACH = 5  # questions for each kind of refused answer

UNREADABLE = (
    "I would go towards my place, but it depends on the others.",
    "Somewhere in the middle should be fine.",
    "Let me think about it and answer in the next round.",
)

STEP_SLIPS: dict[str, Callable[[Point, Point, float], Point]] = {
    "too long": lambda here, goal, step: away(here, 2.5 * step, unit(here, goal)),
    "beyond": lambda here, goal, step: away(here, 0.95 * step, unit(here, goal)),
    "backwards": lambda here, goal, step: away(here, -0.8 * step, unit(here, goal)),
}
"""Kinds of refused steps, made from the own position, the goal and the step limit."""

PLAN_SLIPS: dict[str, Callable[[Points, Mission], Points]] = {
    "one place less": lambda rows, _: rows[:-1],
    "off the centre": lambda rows, mission: rows + 0.8 * mission.spacing,
    "too small": lambda rows, mission: rows.mean(axis=0) + 0.2 * (rows - rows.mean(axis=0)),
    "stretched": lambda rows, _: rows.mean(axis=0) + (rows - rows.mean(axis=0)) * np.array([1.5, 0.7]),
}
"""Kinds of refused plans, made from a right one."""


def retry_questions(rng: np.random.Generator) -> Iterator[Question]:
    """Steps and plans after a refused answer, `RETRIES_EACH` of each kind of slip, and after unreadable ones."""
    for kind, slip in STEP_SLIPS.items():
        distances = (0.1, 0.5) if kind == "beyond" else (1.5, 6.0)
        for number in range(RETRIES_EACH):
            yield _refused_step(rng, kind, slip, number, distances)
    for kind, slip in PLAN_SLIPS.items():
        for number in range(RETRIES_EACH):
            yield _refused_plan(rng, kind, slip, number)
    for number in range(RETRIES_EACH):
        question = draw_step(rng, "far", STEP_TEAMS[number % len(STEP_TEAMS)], float(rng.uniform(1.2, 6.0)))
        text = UNREADABLE[number % len(UNREADABLE)]
        yield replace(question, section="retry", tags=("unreadable", "step"), first={"text": text})


def agreement_questions(rng: np.random.Generator) -> Iterator[Question]:
    """Steps to the team's place by a robot that has proposed another orientation, with another on the straight way."""
    made = 0
    while made < 20:
        question = draw_step(rng, "ahead", STEP_TEAMS[made % len(STEP_TEAMS)], float(rng.uniform(0.6, 5.0)))
        mission = question.build_mission()
        own = rounded_rows(draw_plan(rng, mission), mission.spacing)
        slot = int(rng.integers(len(own)))
        found = replace(question, section="agreement", own={"plan": own, "slot": slot})
        asked, step = found.step_question(mission, 0), sidestep(found, mission)
        objection = check_proposal(mission, Plan.of(own), (), asked.position)
        # The ways to the own place by the team's plan and by the own one are clearly apart, and so is the step aside.
        apart = _angle_deg(asked.position, asked.goal, own[slot]) > 40.0
        if objection is None and apart and step is not None and shortfall(found, mission, [step]) is None:
            made += 1
            yield found


def _refused_step(
    rng: np.random.Generator,
    kind: str,
    slip: Callable[[Point, Point, float], Point],
    number: int,
    distances: tuple[float, float],
) -> Question:
    while True:
        drawn = "near" if kind == "beyond" else "far"
        question = draw_step(rng, drawn, STEP_TEAMS[number % len(STEP_TEAMS)], float(rng.uniform(*distances)))
        mission = question.build_mission()
        asked = question.step_question(mission, 0)
        answer = round_point(slip(asked.position, asked.goal, mission.max_step), mission.spacing)
        if step_faults(asked, answer):
            return replace(question, section="retry", tags=(kind, "step"), first={"waypoint": answer})


def _refused_plan(
    rng: np.random.Generator, kind: str, slip: Callable[[Points, Mission], Points], number: int
) -> Question:
    while True:
        shape, n = STEP_TEAMS[number % len(STEP_TEAMS)]
        fields: dict[str, Any] = draw_fields(rng, shape, n)
        mission = build_mission(**fields)
        robot = int(rng.integers(n))
        question = Question(id="", section="retry", n=n, tags=(kind, "plan"), mission=fields, robots=(robot,))
        answer = rounded_rows(slip(draw_plan(rng, mission), mission), mission.spacing)
        if check_proposal(mission, Plan.of(answer), (), mission.center) is not None:
            return replace(question, first={"plan": answer, "slot": robot % len(answer)})


def _angle_deg(here: Point, one: Point, other: Point) -> float:
    cosine = sum(a * b for a, b in zip(unit(here, one), unit(here, other), strict=True))
    return math.degrees(math.acos(min(1.0, max(-1.0, cosine))))
