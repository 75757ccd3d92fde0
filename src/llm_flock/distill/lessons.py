"""Examples as files, and as batches whose rows begin alike."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from llm_flock.distill.examples import Example
from llm_flock.errors import InputError

POOL = 80
"""So many batches are put together at a time: sorted within, in random order among one another."""

ALIKE = 40
"""So many first tokens decide which rows are put together; beyond them rows may differ, and batches are as varied."""


def write_examples(path: Path, examples: Iterable[Example]) -> int:
    """Write examples as JSON lines; gives their number."""
    count = 0
    with path.open("w", encoding="utf-8") as file:
        for example in examples:
            file.write(json.dumps(asdict(example)) + "\n")
            count += 1
    return count


def read_examples(path: Path) -> list[Example]:
    """Read what `write_examples` wrote.

    Raises:
        InputError: for field `data`: the file cannot be read, or a line is no example.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("data", str(path), f"a file of examples that can be read ({error})") from None
    examples: list[Example] = []
    for number, line in enumerate(lines, start=1):
        try:
            examples.append(Example(**json.loads(line)))
        except (TypeError, ValueError) as error:
            raise InputError(
                "data", f"{path}, line {number}", f"an example as `distill data` writes it ({error})"
            ) from None
    if not examples:
        raise InputError("data", str(path), "a file with at least one example")
    return examples


@dataclass(frozen=True, slots=True)
class Row:
    """One example as tokens: what is told, and what is to be learnt."""

    prompt: tuple[int, ...]
    answer: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Batch:
    """Rows of which the first `shared` tokens are the same: they are computed once for all.

    Attributes:
        prefix: the tokens that all prompts begin with.
        tokens: what follows in each row, filled up with zeros, shape (rows, length).
        labels: the token that is to follow each token, -1 where nothing is learnt, shape (rows, length).
    """

    prefix: tuple[int, ...]
    tokens: np.ndarray[tuple[int, int], np.dtype[np.int64]]
    labels: np.ndarray[tuple[int, int], np.dtype[np.int64]]


def shared_prefix(rows: Sequence[Row]) -> int:
    """How many tokens all prompts begin with; at least the last one of every prompt is left over."""
    first, last = min(row.prompt for row in rows), max(row.prompt for row in rows)
    most = min(len(row.prompt) for row in rows) - 1
    count = 0
    while count < most and first[count] == last[count]:
        count += 1
    return count


def make_batch(rows: Sequence[Row]) -> Batch:
    """Rows as arrays; only answers are learnt."""
    shared = shared_prefix(rows)
    length = max(len(row.prompt) + len(row.answer) for row in rows) - shared - 1
    tokens, labels = np.zeros((len(rows), length), np.int64), np.full((len(rows), length), -1, np.int64)
    for i, row in enumerate(rows):
        told = (row.prompt + row.answer)[shared:-1]
        tokens[i, : len(told)] = told
        begin = len(row.prompt) - shared - 1
        labels[i, begin : begin + len(row.answer)] = row.answer
    return Batch(rows[0].prompt[:shared], tokens, labels)


def plan_epoch(rows: Sequence[Row], budget: int, rng: np.random.Generator, together: int = 1) -> list[list[list[int]]]:
    """Every row once, as numbers in batches of similar rows; some batches, of different kinds, make one step.

    Args:
        rows: all examples.
        budget: about so many tokens a batch, those of the shared beginning counted once.
        rng: the order.
        together: batches of a step, at most.
    """
    order: list[int] = rng.permutation(len(rows)).tolist()
    typical = max(1, int(np.mean([len(row.prompt) + len(row.answer) for row in rows])))
    pool = max(1, POOL * budget // typical)
    steps: list[list[list[int]]] = []
    for begin in range(0, len(order), pool):
        chosen = sorted(order[begin : begin + pool], key=lambda i: rows[i].prompt[:ALIKE])
        batches = _cut([rows[i] for i in chosen], chosen, budget)
        # Sorted as they are, batches far apart differ in kind: a step learns from all kinds, and forgets none.
        stride = -(-len(batches) // together)
        steps += [batches[i::stride] for i in range(stride)]
    return [steps[i] for i in rng.permutation(len(steps))]


def _cut(rows: Sequence[Row], numbers: Sequence[int], budget: int) -> list[list[int]]:
    """Neighbours in a sorted list, as many together as the budget allows."""
    out: list[list[int]] = []
    now: list[int] = []
    held: list[Row] = []
    for row, number in zip(rows, numbers, strict=True):
        together = [*held, row]
        shared = shared_prefix(together)
        cost = shared + len(together) * (max(len(r.prompt) + len(r.answer) for r in together) - shared)
        if held and cost > budget:
            out.append(now)
            now, held = [], []
        now.append(number)
        held.append(row)
    return [*out, now] if now else out
