"""Scores answers by code: whether robots would accept them, and how far they are off.

The verdict is that of the checks in `llm_flock.protocol._verification`. A few questions ask for more: the shape that
words describe, a way that is clear of obstacles, the team's plan and not the own one, different places.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, cast

import numpy as np

from llm_flock import metrics
from llm_flock.arrays import Point
from llm_flock.errors import AnswerError, InputError
from llm_flock.llm import answer_of, draft_of
from llm_flock.mission import Mission
from llm_flock.planner import PlanAnswer, PlanQuestion, StepAnswer
from llm_flock.protocol import ROUNDING, check_plan, check_proposal, judge, straight_path
from llm_flock_lab._exam.questions import Question


@dataclass(frozen=True, slots=True, kw_only=True)
class Marks:
    """The marks of one answer that could be read; None where one does not apply."""

    flyable: bool  # clipped if need be
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
    flyable = judge(asked, answer, shield_on=True).fit is not None
    return Marks(flyable=flyable, error=math.dist(end, wanted) / mission.max_step)


def meant(question: Question, mission: Mission) -> Mission:
    """The mission against which a plan is scored: where words describe a shape, the one that they mean."""
    return mission if question.meant is None else mission.change(shape=question.meant)


def shortfall(question: Question, mission: Mission, answers: Sequence[PlanAnswer | StepAnswer]) -> str | None:
    """The further demand of a question that accepted answers fail, as a sentence; None if they meet all."""
    if question.section == "place":
        taken = [answer.slot for answer in answers if isinstance(answer, PlanAnswer)]
        return None if len(set(taken)) == len(taken) else f"the robots choose the places {taken}."
    (answer,) = answers
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
    """The marks of a mission that a model read; `reason` says what is wrong, None if nothing is."""

    reason: str | None
    read: bool
    safe: bool  # whether no user would be shown a mission that was not asked for


def word_marks(question: Question, text: str) -> WordMarks:
    """Compare a mission that a model read with the words; an impossible one is right if it says them and is refused."""
    assert question.wanted is not None
    refused: str | None = None
    try:
        answer = answer_of(text)
    except AnswerError as error:
        return WordMarks(reason=str(error), read=False, safe=True)
    stages = answer.model_dump(include={"stages"}, exclude_none=True)["stages"]
    said: dict[str, Any] = stages[0]["parts"][0] if [len(stage["parts"]) for stage in stages] == [1] else {}
    fields: dict[str, Any] = said | ({} if answer.robots is None else {"n_robots": answer.robots})
    try:
        draft_of(text)
    except (AnswerError, InputError) as error:
        refused = str(error)
    wrong = _differs(question.wanted, fields)
    safe = refused is not None or (question.possible and wrong is None)
    if wrong is None and question.possible and refused is not None:
        wrong = refused
    if wrong is None and not question.possible and refused is None:
        wrong = "a mission came out that cannot be flown."
    return WordMarks(reason=wrong, read=True, safe=safe)


def _differs(wanted: Mapping[str, object], fields: Mapping[str, object]) -> str | None:
    """The first field that differs. One that was not mentioned may be left out, or have the mission's default."""
    defaults = {name: Mission.model_fields[name].default for name in ("center", "spacing")}
    for name in ("shape", "n_robots", "center", "spacing"):
        asked, found = wanted.get(name, defaults.get(name)), fields.get(name, defaults.get(name))
        if isinstance(asked, tuple | list) and isinstance(found, tuple | list):
            asked, found = list(cast("tuple[float, ...]", asked)), list(cast("tuple[float, ...]", found))
        if asked != found:
            return f"{name} is {found!r}, and the words say {asked!r}."
    return None
