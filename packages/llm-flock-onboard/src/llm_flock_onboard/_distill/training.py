"""Train a student: constant rate, then decay; with checkpoints to resume from."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from llm_flock.errors import InputError
from llm_flock_onboard._distill import need
from llm_flock_onboard._distill.batches import Lesson, make_batch, plan_epoch
from llm_flock_onboard._distill.student import Student
from llm_flock_onboard._local.engine import cores

logger = logging.getLogger(__name__)

STATE, FACTORS = "state.pt", "factors.npz"
"""Files in the folder of a training: the checkpoint, and the factors for `export`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingOptions:
    """How to train."""

    steps: int = 3000  #: Optimizer steps in all, at most.
    minutes: float | None = None  #: Time of the training, by which the rate falls; None goes by the steps.
    rate: float = 2e-3  #: Learning rate of AdamW before it decays.
    descent: float = 0.3  #: Share of the steps, the last ones, over which the rate falls to zero.
    warm_up: int = 20  #: Steps over which it rises.
    tokens: int = 600  #: Size of all batches of a step, about.
    together: int = 4  #: Batches of a step, of different kinds of questions; all have the same weight.
    keep_s: float = 100.0  #: Time between two checkpoints [s].
    seed: int = 0

    def done(self, step: int, spent_s: float) -> float:
        """The share of the training that is over: of the steps, or of the time if that is nearer to its end."""
        return max(step / self.steps, 0.0 if self.minutes is None else spent_s / 60.0 / self.minutes)

    def rate_at(self, step: int, spent_s: float = 0.0) -> float:
        """The learning rate of a step, counted from 0."""
        left = (1.0 - self.done(step, spent_s)) / max(1e-9, self.descent)
        return self.rate * max(0.0, min(1.0, (step + 1) / self.warm_up, left))


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingProgress:
    """Steps done, of `steps` in all, and examples seen; `loss` is the mean of the last 50 steps [nats per token]."""

    step: int
    steps: int
    examples: int
    loss: float = 0.0
    rate: float = 0.0
    left_s: float = 0.0


def train(
    student: Student,
    lessons: Sequence[Lesson],
    options: TrainingOptions,
    folder: Path,
    *,
    resume: bool = False,
    on_progress: Callable[[TrainingProgress], None] = lambda _: None,
) -> TrainingProgress:
    """Train a student in place, with checkpoints in a folder.

    Lessons are repeated in another order each epoch; `on_progress` is called after every step.

    Raises:
        InputError: there is no checkpoint to resume from, or one of another student.
    """
    torch = need("torch")
    folder.mkdir(parents=True, exist_ok=True)
    threads = min(cores(), options.together) if student.device == "cpu" else 1

    def learn(batch: Sequence[int]) -> tuple[float, Sequence[Any]]:
        """Loss and gradients of one batch; a batch is small, so that each core is quicker with one of its own."""
        if threads > 1:
            torch.set_num_threads(cores() // threads)
        loss = student.loss(make_batch([lessons[i] for i in batch]))
        return float(loss.detach()), torch.autograd.grad(loss, student.parameters)

    pool = ThreadPoolExecutor(threads)
    optimizer = torch.optim.AdamW(student.parameters, lr=options.rate, betas=(0.9, 0.98), weight_decay=0.0)
    step = examples = 0
    losses: list[float] = []
    if resume:
        step, examples = _load_checkpoint(torch, student, optimizer, folder)
    epoch = 0
    queue: list[list[list[int]]] = []
    began, kept = time.monotonic(), time.monotonic()
    first, progress = step, TrainingProgress(step=step, steps=options.steps, examples=examples)
    while options.done(step, time.monotonic() - began) < 1.0:
        if not queue:
            # The seed depends on the first step: a resumed training draws new orders.
            rng = np.random.default_rng([options.seed, first, epoch])
            queue = plan_epoch(lessons, options.tokens // options.together, rng, options.together)
            epoch += 1
        chosen = queue.pop()
        rate = options.rate_at(step, time.monotonic() - began)
        for group in optimizer.param_groups:
            group["lr"] = rate
        parts = list(pool.map(learn, chosen))
        loss = sum(part for part, _ in parts) / len(parts)
        for parameter, *gradients in zip(student.parameters, *(part for _, part in parts), strict=True):
            parameter.grad = sum(gradients) / len(parts)
        torch.nn.utils.clip_grad_norm_(student.parameters, 1.0)
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)
        step, examples = step + 1, examples + sum(map(len, chosen))
        losses = [*losses[-49:], loss]
        now = time.monotonic()
        over, before = options.done(step, now - began), options.done(first, 0.0)
        progress = TrainingProgress(
            step=step,
            steps=options.steps,
            loss=float(np.mean(losses)),
            examples=examples,
            rate=rate,
            left_s=(now - began) * (1.0 - over) / max(1e-9, over - before),
        )
        on_progress(progress)
        if now - kept > options.keep_s:
            _save_checkpoint(torch, student, optimizer, folder, step, examples)
            kept = now
    pool.shutdown()
    _save_checkpoint(torch, student, optimizer, folder, step, examples)
    return progress


def _save_checkpoint(torch: Any, student: Student, optimizer: Any, folder: Path, step: int, examples: int) -> None:
    """Write both files, each atomically: a training may be ended at any moment."""
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
    logger.info("checkpoint after step %d in %s", step, folder)


def _load_checkpoint(torch: Any, student: Student, optimizer: Any, folder: Path) -> tuple[int, int]:
    """Read the files of `_save_checkpoint` and return the numbers of steps and examples."""
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
