"""The two splits: the public one is a file of the package, a private one is generated on demand."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from importlib import resources
from itertools import groupby

import numpy as np

from llm_flock.errors import InputError, unknown
from llm_flock_lab._exam.generate_plans import distraction_questions, place_questions, plan_questions
from llm_flock_lab._exam.generate_steps import others_questions, path_questions, step_questions
from llm_flock_lab._exam.generate_talks import agreement_questions, retry_questions
from llm_flock_lab._exam.questions import SECTIONS, Question, from_lines

VERSION = 2
"""Version of the exam. It changes with the questions, their scoring or the kinds of questions; prompts have their own
digest in every result."""

PUBLIC_SEED = 20_250  # seed of the public split. A private split may not have it

PUBLIC_FILE = "public-v2.jsonl"

WRITTEN_FILE = "written-v2.jsonl"  # questions in words, which were written and not generated; there are no private ones

_MAKERS: Mapping[str, Callable[[np.random.Generator], Iterator[Question]]] = {
    "plan": plan_questions,
    "place": place_questions,
    "step": step_questions,
    "others": others_questions,
    "path": path_questions,
    "retry": retry_questions,
    "agreement": agreement_questions,
    "distraction": distraction_questions,
}


def generate(seed: int) -> list[Question]:
    """All questions of a seed that are generated, in the order of the sections."""
    found: list[Question] = []
    for number, section in enumerate(SECTIONS):
        if section in _MAKERS:
            made = _MAKERS[section](np.random.default_rng([1, seed, number, 0]))
            found += [replace(question, id=f"{section}-{k:04d}") for k, question in enumerate(made)]
    return found


@lru_cache(maxsize=1)
def public_split() -> tuple[Question, ...]:
    folder, order = resources.files("llm_flock_lab._exam"), list(SECTIONS)
    texts = {name: folder.joinpath(name).read_text(encoding="utf-8") for name in (PUBLIC_FILE, WRITTEN_FILE)}
    found = [question for name, text in texts.items() for question in from_lines(text, name)]
    return tuple(sorted(found, key=lambda question: order.index(question.section)))


@lru_cache(maxsize=4)
def private_split(seed: int) -> tuple[Question, ...]:
    """The generated questions of another seed: the same kinds and numbers of them, none of them public."""
    if seed == PUBLIC_SEED:
        raise InputError("seed", seed, "another seed than that of the public split")
    return tuple(generate(seed))


def paper(
    split: str = "public", seed: int | None = None, sections: str | None = None, limit: int | None = None
) -> tuple[Question, ...]:
    """The questions that are asked: `limit` of each section at most, evenly spread over it."""
    if split not in ("public", "private"):
        raise InputError("split", split, "public or private")
    if split == "private" and seed is None:
        raise InputError("seed", None, "a seed of the private split, which you keep for yourself")
    if split == "public" and seed not in (None, PUBLIC_SEED):
        raise InputError("seed", seed, says="belongs to a private split: --split private")
    for name, number, least in (("seed", seed, 0), ("limit", limit, 1)):
        if number is not None and number < least:
            raise InputError(name, number, f"at least {least}")
    names = list(SECTIONS) if sections is None else [name.strip() for name in sections.split(",")]
    for name in names:
        if name not in SECTIONS:
            raise InputError("sections", name, says=unknown("section", name, SECTIONS))
    whole = public_split() if split == "public" or seed is None else private_split(seed)
    found: list[Question] = []
    for section, group in groupby(whole, key=lambda question: question.section):
        if section in names:
            all_ = list(group)
            count = len(all_) if limit is None else min(limit, len(all_))
            found += [all_[k * len(all_) // count] for k in range(count)]
    return tuple(found)
