"""The prompts that the packaged adapter was taught, by its documented recipe: which questions are held out from it?

The adapter's own examples were not kept. What counts is the set that the recipe makes
(`llm-flock distill data train.jsonl --count 3000 --plans 60`).
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

from llm_flock.distill.examples import Example, motion_examples, plan_examples

MOTIONS, PLANS = 3000, 60
"""Numbers of the recipe: examples of steps and paths, and sets of plans."""


def recipe_examples() -> Iterable[Example]:
    """Every example of the recipe, in its order."""
    yield from motion_examples(0, MOTIONS, "train")
    for seed in range(PLANS):
        yield from plan_examples(seed, "train")


def distinct_prompts(examples: Iterable[Example]) -> frozenset[tuple[str, str]]:
    """System and user message of each example, every pair once."""
    return frozenset((example.system, example.user) for example in examples)


@lru_cache(maxsize=1)
def training_prompts() -> frozenset[tuple[str, str]]:
    """System and user message of every example of the recipe."""
    return distinct_prompts(recipe_examples())
