"""Reads a plan that a model gives as a formation program: one JSON object, whose length does not grow with the team."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, cast

from llm_flock.errors import AnswerError, InputError
from llm_flock.formation import parse_program
from llm_flock.llm._thoughts import answer_text
from llm_flock.mission import Mission
from llm_flock.plan import Drawing, Plan

FIELDS = {"reasoning", "program", "my_plan"}
REQUIRED = 'a JSON object {"program": {...}, "my_plan": a} is required'


def read_program(text: str, mission: Mission) -> tuple[Plan, int]:
    """The places that the program in an answer gives to this team, and the model's own place among them.

    Raises:
        AnswerError: no such object, several that differ, or a program that cannot be drawn by this team; a sentence.
    """
    found = [given for given in _objects(answer_text(text)) if "program" in given or "my_plan" in given]
    if not found:
        raise AnswerError(f"it holds no complete program; {REQUIRED}.")
    if any(given != found[0] for given in found[1:]):
        raise AnswerError(f"it holds {len(found)} programs that differ, one is required.")
    given, n = found[0], mission.n_places
    if unknown := sorted(given.keys() - FIELDS):
        raise AnswerError(f"it has a field {unknown[0]!r:.40}; {REQUIRED}, with the drawing inside the program.")
    slot = given.get("my_plan")
    if isinstance(slot, bool) or not isinstance(slot, int) or not 0 <= slot < n:
        raise AnswerError(f"my_plan is {slot!r:.40}; a whole number from 0 to {n - 1} is required.")
    try:
        program = parse_program(cast("Any", given.get("program")))
        plan = Plan(drawing=Drawing(program.text, n, mission.spacing, mission.center))
        _ = plan.points
    except InputError as error:
        raise AnswerError(f"its program cannot be drawn: {error}") from None
    return plan, slot


def _objects(text: str) -> Iterator[Mapping[str, Any]]:
    """The JSON objects in a text, outermost ones only."""
    decoder, at = json.JSONDecoder(), text.find("{")
    while at >= 0:
        try:
            value, end = decoder.raw_decode(text, at)
        except (ValueError, RecursionError):
            value, end = None, at + 1
        if isinstance(value, dict):
            yield cast("Mapping[str, Any]", value)
        at = text.find("{", end)
