"""The training itself: a constant rate, then a descent; kept often, and gone on with after a break."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from llm_flock.distill.extra import need
from llm_flock.distill.lessons import Row, make_batch, plan_epoch
from llm_flock.distill.student import Student
from llm_flock.errors import InputError

logger = logging.getLogger(__name__)

STATE, FACTORS = "state.pt", "factors.npz"
"""In the folder of a training: what goes on with it, and the factors as they are."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """How to train.

    Attributes:
        steps: optimizer steps in all.
        rate: learning rate of AdamW until the descent.
        descent: share of the steps, the last ones, over which the rate falls to nothing.
        warm_up: steps over which it rises.
        tokens: the batches of a step hold about so many.
        together: batches of a step, of different kinds of questions; each kind counts as much as the others.
        keep_s: time between two checkpoints [s].
        seed: order of the examples, and the factors at the beginning.
    """

    steps: int = 3000
    rate: float = 2e-3
    descent: float = 0.3
    warm_up: int = 20
    tokens: int = 600
    together: int = 2
    keep_s: float = 120.0
    seed: int = 0

    def rate_at(self, step: int) -> float:
        """The learning rate of a step, counted from 0."""
        left = (self.steps - step) / max(1.0, self.descent * self.steps)
        return self.rate * min(1.0, (step + 1) / self.warm_up, left)


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """Where a training stands.

    Attributes:
        step: steps done.
        steps: of so many.
        loss: mean of the last ones, per token of an answer [nats].
        examples: seen in all.
        rate: learning rate.
        left_s: time still to go at the present speed [s].
    """

    step: int
    steps: int
    loss: float
    examples: int
    rate: float
    left_s: float


def train(
    student: Student,
    rows: Sequence[Row],
    course: Course,
    folder: Path,
    *,
    resume: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
) -> Progress:
    """Teach a student, and keep its factors in a folder.

    Args:
        student: learns in place.
        rows: what it is taught, over and over, each time in another order.
        course: how.
        folder: where it is kept; made if need be.
        resume: go on with what is kept there.
        on_progress: told of every step.

    Raises:
        InputError: there is nothing to go on with, or it is of another student.
    """
    torch = need("torch")
    folder.mkdir(parents=True, exist_ok=True)
    optimizer = torch.optim.AdamW(student.parameters, lr=course.rate, betas=(0.9, 0.98), weight_decay=0.0)
    step = examples = 0
    losses: list[float] = []
    if resume:
        step, examples = _restore(torch, student, optimizer, folder)
    epoch = 0
    queue: list[list[list[int]]] = []
    began, kept = time.monotonic(), time.monotonic()
    first, progress = step, Progress(step=step, steps=course.steps, loss=0.0, examples=examples, rate=0.0, left_s=0.0)
    while step < course.steps:
        if not queue:
            # Which epoch it is follows from the step: a training that is gone on with draws new orders.
            rng = np.random.default_rng([course.seed, first, epoch])
            queue = plan_epoch(rows, course.tokens // course.together, rng, course.together)
            epoch += 1
        chosen = queue.pop()
        rate = course.rate_at(step)
        for group in optimizer.param_groups:
            group["lr"] = rate
        loss = 0.0
        for batch in chosen:
            share = student.loss(make_batch([rows[i] for i in batch])) / len(chosen)
            share.backward()
            loss += float(share.detach())
        torch.nn.utils.clip_grad_norm_(student.parameters, 1.0)
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)
        step, examples = step + 1, examples + sum(map(len, chosen))
        losses = [*losses[-49:], loss]
        now = time.monotonic()
        progress = Progress(
            step=step,
            steps=course.steps,
            loss=float(np.mean(losses)),
            examples=examples,
            rate=rate,
            left_s=(now - began) / (step - first) * (course.steps - step),
        )
        if on_progress is not None:
            on_progress(progress)
        if now - kept > course.keep_s or step == course.steps:
            _keep(torch, student, optimizer, folder, step, examples)
            kept = now
    return progress


def _keep(torch: Any, student: Student, optimizer: Any, folder: Path, step: int, examples: int) -> None:
    """Write both files whole or not at all: a training may be ended at any moment."""
    state = {
        "factors": {name: [a.detach(), b.detach()] for name, (a, b) in student.factors.items()},
        "optimizer": optimizer.state_dict(),
        "step": step,
        "examples": examples,
    }
    torch.save(state, folder / (STATE + ".new"))
    (folder / (STATE + ".new")).replace(folder / STATE)
    student.adapter().save(folder / (FACTORS + ".new"))
    (folder / (FACTORS + ".new")).replace(folder / FACTORS)
    logger.info("kept after step %d in %s", step, folder)


def _restore(torch: Any, student: Student, optimizer: Any, folder: Path) -> tuple[int, int]:
    """What `_keep` wrote; gives steps and examples."""
    if not (folder / STATE).is_file():
        raise InputError("resume", str(folder), f"a folder in which a training has kept {STATE}")
    state = torch.load(folder / STATE, map_location=student.device, weights_only=True)
    given, own = state["factors"], student.factors
    if given.keys() != own.keys() or any(given[n][0].shape != own[n][0].shape for n in own):
        raise InputError("resume", str(folder), "a training of the same base with the same rank")
    with torch.no_grad():
        for name, pair in given.items():
            for mine, theirs in zip(own[name], pair, strict=True):
                mine.copy_(theirs)
    optimizer.load_state_dict(state["optimizer"])
    return int(state["step"]), int(state["examples"])
