"""Scores answers by code: whether robots would accept them, and how far they are off.

The verdict is that of the checks in `llm_flock.protocol._verification`. A few questions ask for more: the shape that
words describe, a way that is clear of obstacles, the team's plan and not the own one, different places.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from llm_flock import metrics
from llm_flock.arrays import Point
from llm_flock.errors import AnswerError, InputError
from llm_flock.formation import Program, parse_program
from llm_flock.llm import answer_of, draft_of, drawn_program, edited, refusal
from llm_flock.mission import Mission
from llm_flock.planner import JudgementAnswer, PlanAnswer, PlanQuestion, StepAnswer
from llm_flock.protocol import ROUNDING, check_plan, check_proposal, judge, straight_path
from llm_flock_lab._exam.questions import Question
from llm_flock_lab._exam.words import drawing_differs, mission_differs


@dataclass(frozen=True, slots=True, kw_only=True)
class Marks:
    """The marks of one answer that could be read; None where one does not apply."""

    flyable: bool  # as it is, not clipped
    error: float | None = None  # from the best answer [step limits]; of a plan, mean distance from the shape [spacings]


def objection_to_plan(question: PlanQuestion, answer: PlanAnswer) -> str | None:
    """The reason why a robot rejects its own model's plan, as told to the model; None if it does not."""
    return check_proposal(question.mission, answer.plan, question.still, question.position)


def plan_marks(question: Question, mission: Mission, answer: PlanAnswer) -> Marks:
    asked = question.plan_question(mission, question.robots[0], 0)
    rows = answer.plan.array
    ideal = meant(question, mission).ideal
    error = None
    if ideal is not None and len(ideal) == len(rows):
        error = metrics.ShapeTarget(np.array(ideal)).error(rows).mean / mission.spacing
    return Marks(flyable=objection_to_plan(asked, answer) is None, error=error)


def step_marks(question: Question, mission: Mission, answer: StepAnswer) -> Marks:
    asked = question.step_question(mission, 0)
    best = straight_path(asked)
    end = (answer.waypoint, *answer.path)[-1]
    wanted = (best.waypoint, *best.path)[-1]
    flyable = judge(asked, answer, shield_on=True).reason is None
    return Marks(flyable=flyable, error=math.dist(end, wanted) / mission.max_step)


def meant(question: Question, mission: Mission) -> Mission:
    """The mission against which a plan is scored: where words describe a shape, the one that they mean."""
    return mission if question.meant is None else mission.change(shape=question.meant)


def shortfall(
    question: Question, mission: Mission, answers: Sequence[PlanAnswer | StepAnswer | JudgementAnswer]
) -> str | None:
    """The further demand of a question that accepted answers fail, as a sentence; None if they meet all."""
    if question.section == "place":
        plans = [answer for answer in answers if isinstance(answer, PlanAnswer)]
        asked, taken = question.plan_question(mission, 0, 0), [answer.slot for answer in plans]
        # A place is one of a shape: without a right plan, its number says nothing.
        if (wrong := next(filter(None, (objection_to_plan(asked, answer) for answer in plans)), None)) is not None:
            return wrong
        return None if len(set(taken)) == len(taken) else f"the robots choose the places {taken}."
    (answer,) = answers
    if isinstance(answer, JudgementAnswer):
        right = question.wanted[0]["choice"]
        return None if answer.choice == right else f"{answer.choice} is chosen, and {right} is right."
    if isinstance(answer, PlanAnswer):
        return check_plan(meant(question, mission), answer.plan) if question.meant is not None else None
    assert question.position is not None
    way = [question.position, answer.waypoint, *answer.path]
    for start, end in pairwise(way):
        if any(o.segment_distance(start, end) < (1 - ROUNDING) * mission.body_radius for o in mission.obstacles):
            return "the way comes too near to an obstacle."
    if question.own is not None and not _nearer_to_team(question, mission, answer.waypoint):
        return "the step heads for the place in the own plan, not in the team's."
    return None


def _nearer_to_team(question: Question, mission: Mission, waypoint: Point) -> bool:
    """Whether a waypoint is nearer to the best one by the team's plan than to the best one by the own plan."""
    assert question.own is not None
    asked = question.step_question(mission, 0)
    place = tuple(question.own["plan"][question.own["slot"]])
    own = straight_path(replace(asked, target=place, corner=None)).waypoint
    return math.dist(waypoint, straight_path(asked).waypoint) < math.dist(waypoint, own)


@dataclass(frozen=True, slots=True, kw_only=True)
class WordMarks:
    """The marks of an answer to words; `reason` says what is wrong, None if nothing is."""

    reason: str | None
    read: bool
    safe: bool  # whether no user would be shown what was not asked for


def word_marks(question: Question, text: str) -> WordMarks:
    """Compare a mission or an edited program with the right answers to the words, by what would be flown."""
    if question.section == "edit":
        try:
            assert question.mission is not None
            before = drawn_program(question.mission["shape"])
            drawn = None if refusal(text) is not None else edited(text, before)
            wrong = [_edit_differs(wanted, drawn) for wanted in question.wanted]
        except InputError as error:  # no program, or one for another number of robots
            return WordMarks(reason=str(error), read=False, safe=True)
        return WordMarks(reason=None if None in wrong else wrong[0], read=True, safe=None in wrong or drawn is None)
    base, shown = question.build_mission(), False
    try:
        found = answer_of(text).model_dump(exclude_none=True)
    except AnswerError as error:
        return WordMarks(reason=str(error), read=False, safe=True)
    wrong = [_answer_differs(wanted, found, base) for wanted in question.wanted]
    if found["answer"] == "mission" and None not in wrong:
        with suppress(InputError):  # people are told why, and nothing flies
            draft_of(text, base, flying=question.flying)
            shown = True
    return WordMarks(reason=None if None in wrong else wrong[0], read=True, safe=not shown)


def _answer_differs(wanted: Mapping[str, Any], found: Mapping[str, Any], base: Mission) -> str | None:
    if found["answer"] != wanted["answer"]:
        return f"the answer is {found['answer']}, and {wanted['answer']} is right."
    if wanted["answer"] == "ask":
        about = found.get("about")
        return None if about in wanted["about"] else f"it asks about {about}, and {wanted['about'][0]} is unclear."
    return None if wanted["answer"] == "refuse" else mission_differs(wanted, found, base)


def _edit_differs(wanted: Mapping[str, Any], drawn: Program | None) -> str | None:
    if ("refuse" in wanted) != (drawn is None):
        return f"it {'refuses' if drawn is None else 'draws'}, and the words ask for the other."
    return None if drawn is None else drawing_differs(parse_program(wanted), drawn)
