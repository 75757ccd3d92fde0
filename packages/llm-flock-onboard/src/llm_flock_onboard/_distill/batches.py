"""Training examples as tokens, in batches whose prompts share their first tokens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile

import numpy as np

POOL = 80
"""Batches that are formed together: lessons are sorted within the pool, its batches are in random order."""

ALIKE = 40
"""First tokens by which lessons are sorted; beyond them they may differ, which keeps batches varied."""


@dataclass(frozen=True, slots=True)
class Lesson:
    """One example as tokens: the prompt, and the answer to learn."""

    prompt: tuple[int, ...]
    answer: tuple[int, ...]

    def __len__(self) -> int:
        return len(self.prompt) + len(self.answer)


@dataclass(frozen=True, slots=True)
class Batch:
    """Lessons with a common prefix, which is computed once; the other tokens are padded with zeros.

    `labels` are the token to follow each one, -1 where nothing is learnt. Both have the shape (lessons, length).
    """

    prefix: tuple[int, ...]
    tokens: np.ndarray[tuple[int, int], np.dtype[np.int64]]
    labels: np.ndarray[tuple[int, int], np.dtype[np.int64]]


def shared_prefix(lessons: Sequence[Lesson]) -> int:
    """Length of the common prefix of all prompts [tokens]; the last token of a prompt never belongs to it."""
    prompts = [lesson.prompt for lesson in lessons]
    same = takewhile(lambda pair: pair[0] == pair[1], zip(min(prompts), max(prompts), strict=False))
    return min(len(list(same)), min(map(len, prompts)) - 1)


def make_batch(lessons: Sequence[Lesson]) -> Batch:
    """Lessons as arrays; only answers are learnt."""
    shared = shared_prefix(lessons)
    length = max(map(len, lessons)) - shared - 1
    tokens, labels = np.zeros((len(lessons), length), np.int64), np.full((len(lessons), length), -1, np.int64)
    for i, lesson in enumerate(lessons):
        inputs = (lesson.prompt + lesson.answer)[shared:-1]
        tokens[i, : len(inputs)] = inputs
        begin = len(lesson.prompt) - shared - 1
        labels[i, begin : begin + len(lesson.answer)] = lesson.answer
    return Batch(lessons[0].prompt[:shared], tokens, labels)


def plan_epoch(
    lessons: Sequence[Lesson], budget: int, rng: np.random.Generator, together: int = 1
) -> list[list[list[int]]]:
    """Order all lessons of an epoch: steps of batches of indices.

    A batch holds similar lessons, about `budget` tokens with its shared prefix counted once; the batches of a step, at
    most `together`, hold different ones.
    """
    order: list[int] = rng.permutation(len(lessons)).tolist()
    typical = max(1, int(np.mean([len(lesson) for lesson in lessons])))
    pool = max(1, POOL * budget // typical)
    steps: list[list[list[int]]] = []
    for begin in range(0, len(order), pool):
        chosen = sorted(order[begin : begin + pool], key=lambda i: (lessons[i].prompt[:ALIKE], len(lessons[i])))
        batches = _cut_batches(lessons, chosen, budget)
        # Batches far apart in the sorted list differ in kind: each step learns from several kinds, and forgets none.
        stride = -(-len(batches) // together)
        steps += [batches[i::stride] for i in range(stride)]
    return [steps[i] for i in rng.permutation(len(steps))]


def _cut_batches(lessons: Sequence[Lesson], order: Sequence[int], budget: int) -> list[list[int]]:
    """Cut a sorted list into batches, each as large as the budget allows."""
    out: list[list[int]] = []
    shared = longest = 0
    for number in order:
        lesson = lessons[number]
        pair = [lessons[out[-1][0]], lesson] if out else [lesson]
        same, most = min(shared, shared_prefix(pair)), max(longest, len(lesson))
        if out and same + (len(out[-1]) + 1) * (most - same) <= budget:
            out[-1].append(number)
            shared, longest = same, most
        else:
            out.append([number])
            shared, longest = len(lesson.prompt) - 1, len(lesson)
    return out
