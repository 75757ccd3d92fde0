"""Models that sit the exam: one knows every answer, one guesses, one draws its faults from the conversation."""

from __future__ import annotations

import asyncio
import hashlib
import json
from collections.abc import Sequence

import numpy as np

from llm_flock.errors import ModelError
from llm_flock.llm._port import Call
from llm_flock.llm._simulated.model import SimulatedModel
from llm_flock.llm._simulated.profiles import parse_profile
from llm_flock.planner import PlanAnswer, StepAnswer
from llm_flock.protocol._geometry import GeometryPlanner
from llm_flock_lab._exam.ask import round_of
from llm_flock_lab._exam.generate_steps import sidestep
from llm_flock_lab._exam.questions import Question
from llm_flock_lab._exam.score import meant


class Key:
    """Looks up which question it is, and gives a right answer in the words of a model."""

    def __init__(self, questions: Sequence[Question]) -> None:
        self._known = {round_of(question, 0): question for question in questions}

    async def ask(self, call: Call) -> str:
        question = self._known[call.round]
        if question.options:
            return f"Choice: {question.wanted[0]['choice']}"
        if question.words is not None:
            right = question.wanted[0]
            return json.dumps({**right, "about": right["about"][0]} if "about" in right else right)
        mission = question.build_mission()
        if question.asks_plan:
            plan = question.plan_question(meant(question, mission), call.robot, call.round)
            answer = await GeometryPlanner().plan(plan)
            assert isinstance(answer, PlanAnswer), answer
            return f"Plan: {[list(point) for point in answer.plan.points]}\nmy plan: {answer.slot}"
        if question.section in ("others", "agreement"):
            step = sidestep(question, mission)
        else:
            found = await GeometryPlanner().step(question.step_question(mission, call.round))
            step = found if isinstance(found, StepAnswer) else None
        assert step is not None, question.id
        if question.horizon > 1:
            return f"Path: {[list(point) for point in (step.waypoint, *step.path)]}"
        return f"Position: {list(step.waypoint)}"


class Guesser:
    """Answers in the right form with numbers by chance."""

    def __init__(self) -> None:
        self._rng = np.random.default_rng(3)

    async def ask(self, call: Call) -> str:
        await asyncio.sleep(0)
        if call.form is None:
            shape = str(self._rng.choice(["line", "circle", "grid", "star"]))
            center = self._rng.integers(0, 100, 2).tolist()
            return json.dumps({"answer": "mission", "stages": [{"parts": [{"shape": shape, "center": center}]}]})
        if call.form.choices:
            return f"Choice: {self._rng.choice(call.form.choices)}"
        rows = self._rng.uniform(-60, 140, (call.form.n, call.form.dim)).round(2).tolist()
        if call.kind == "plan":
            return f"Plan: {rows}\nmy plan: {int(self._rng.integers(call.form.n))}"
        return f"Path: {rows[:1]}" if call.form.horizon > 1 else f"Position: {rows[0]}"


class Hashed:
    """A stand-in whose chance is the conversation itself, so that it answers alike wherever it is asked."""

    async def ask(self, call: Call) -> str:
        return hashed([(message.role, message.text) for message in call.messages])


def hashed(conversation: Sequence[tuple[str, str]]) -> str:
    """The answer of `Hashed` to a conversation of roles and texts."""
    seed = hashlib.blake2b(json.dumps(list(conversation)).encode(), digest_size=8).digest()
    rng = np.random.default_rng(int.from_bytes(seed))
    if conversation[0][1].startswith(("You turn a request", "You change the drawing")):
        shape = str(rng.choice(["line", "circle", "grid", "star"]))
        return json.dumps({"answer": "mission", "stages": [{"parts": [{"shape": shape}]}]})
    try:
        return SimulatedModel(parse_profile("malformed@0.3,overshoot@0.3,distorted@0.3"), rng).answer(conversation)
    except ModelError as error:  # a stand-in cannot read a shape in words
        return str(error)
