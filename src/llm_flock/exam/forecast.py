"""What an exam will probably take, before anything is asked."""

from __future__ import annotations

from collections.abc import Sequence

from llm_flock.exam.examinee import Examinee
from llm_flock.exam.questions import WORDS, Question
from llm_flock.exam.sit import first_messages
from llm_flock.llm.port import Usage
from llm_flock.llm.prices import cost_usd
from llm_flock.llm.providers import parse_model
from llm_flock.llm.sharing import CHARS_PER_TOKEN
from llm_flock.runtime.forecast import OUTPUT_TOKENS, Expected


def expected_use(examinee: Examinee, questions: Sequence[Question], repeats: int) -> Expected:
    """Calls, tokens and money if every first answer were right, at list prices; `at_most` if none ever were.

    Prompts are rendered and measured; each answer is taken to have as many tokens as `[expect]` of a sweep says.
    """
    asks = [examinee.kind != "geometry"] * sum(len(question.robots) for question in questions)
    chars = sum(
        len(message.text)
        for question in questions
        for messages in first_messages(question, examinee.prompts, examinee.frame)
        for message in messages
    )
    calls = sum(asks) * repeats
    answers = OUTPUT_TOKENS if examinee.kind in ("provider", "plugin", "own") else 0
    tokens_in = repeats * chars / CHARS_PER_TOKEN if calls else 0.0
    tries = 1 + examinee.setup.max_retries
    most = repeats * sum(len(q.robots) * (1 if q.section == WORDS else tries) for q in questions) if calls else 0
    return Expected(
        calls=calls,
        tokens_input=tokens_in,
        tokens_output=float(calls * answers),
        cost_usd=_cost(examinee, calls, tokens_in, answers),
        at_most=most if examinee.setup.max_calls is None else min(most, examinee.setup.max_calls),
    )


def _cost(examinee: Examinee, calls: int, tokens_in: float, answer: int) -> float | None:
    """By list prices; None where no price is known [US dollars]."""
    if examinee.kind == "own":
        return None  # its class may charge anything
    if examinee.kind != "provider" or not calls:
        return 0.0
    if examinee.setup.base_url is not None:
        return None
    name = parse_model(examinee.name)
    price = cost_usd(name.provider, name.model, Usage(input=round(tokens_in / calls), output=answer))
    return None if price is None else price * calls
