"""Judgements in prompts and answers: options with their figures, and the name of the one that is chosen."""

from __future__ import annotations

import re
from collections.abc import Sequence

from llm_flock.errors import AnswerError
from llm_flock.llm._answer_forms import REASONING
from llm_flock.llm._thoughts import answer_text
from llm_flock.message import Choice
from llm_flock.planner import JudgementAnswer, JudgementOption
from llm_flock.printable import one_line

MAX_REASON = 200  # longest reason that is kept [characters]

_CHOICE = re.compile(r"\bchoice\b[\"'*_`\s]*[:=][\"'*_`\s]*([a-z]+)", re.IGNORECASE)
_REASON = re.compile(rf'"{REASONING}"\s*:\s*"((?:[^"\\]|\\.)*)"')


def options_text(options: Sequence[JudgementOption]) -> str:
    """Options as a prompt lists them, one a line."""
    return "\n".join(
        f"- {one.choice}: {one.does} Rounds: {one.rounds}; flying: {one.distance:.1f} units; "
        f"empty places: {one.gaps}; robots lost: {one.lost}."
        for one in options
    )


def read_choice(text: str, names: Sequence[Choice]) -> JudgementAnswer:
    """The choice in an answer, and the reason before it; AnswerError, a sentence for the model, if it has none."""
    required = f"one of {', '.join(names)} is required, as in `Choice: {names[0]}`."
    answer = answer_text(text)
    found = [*_CHOICE.finditer(answer)]
    said = {match[1].lower() for match in found} or {answer.strip("\"'*_`. \n").lower()} & {*names}
    if not said:
        raise AnswerError(f"it holds no choice; {required}")
    if len(said) > 1:
        raise AnswerError(f"it chooses {' and '.join(sorted(said))}; {required}")
    chosen: list[Choice] = [name for name in names if name in said]
    if not chosen:
        raise AnswerError(f"{min(said)[:40]} is not among the options; {required}")
    reason = _REASON.search(answer)
    before = answer[: found[0].start()] if found else ""
    return JudgementAnswer(
        choice=chosen[0], reason=one_line((reason[1] if reason else before).strip(' \n{"*'), MAX_REASON)
    )
