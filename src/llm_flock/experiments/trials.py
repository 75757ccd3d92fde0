"""Many trials at once, each in one process of a pool; what they give depends on their configurations alone."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass

from llm_flock.errors import FlockError, InputError
from llm_flock.llm.models import parse_models
from llm_flock.runtime.api import run
from llm_flock.runtime.config import RunConfig
from llm_flock.runtime.result import Summary


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came of one trial: its figures, or why there are none.

    Attributes:
        seed: seed of the trial.
        summary: its figures; None where it broke off.
        error: what broke it off, in words; None where nothing did. Such a trial counts as failed, it is never dropped.
    """

    seed: int
    summary: Summary | None
    error: str | None = None

    @property
    def formed(self) -> bool:
        """Whether the formation was built."""
        return self.summary is not None and self.summary.formed


@dataclass(frozen=True, slots=True, kw_only=True)
class _Refused:
    """An `InputError` of a worker, in parts: an exception with its own arguments does not survive pickling."""

    field: str
    value: object
    allowed: str


def run_trials(
    configs: Sequence[RunConfig], *, jobs: int, on_outcome: Callable[[Outcome], None] | None = None
) -> list[Outcome]:
    """Fly every configuration, with its record off.

    The workers are started afresh (`spawn`), so a script that calls this needs its
    `if __name__ == "__main__":` guard.

    Args:
        configs: one for each trial.
        jobs: processes at most; each uses one core. With models on board it is one: its engine uses all cores but one.
        on_outcome: told of each outcome, in the order of `configs`.

    Returns:
        outcomes in the order of `configs`, whoever was ready first.

    Raises:
        InputError: a trial was refused, or `jobs` is less than 1.
        FlockError: a worker was killed.
        KeyboardInterrupt: after all workers were stopped.
    """
    if jobs < 1:
        raise InputError("jobs", jobs, "at least 1")
    if not configs:
        return []
    if any(name.startswith("local:") for config in configs for name in _models(config)):
        jobs = 1
    others = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(jobs, len(configs)), mp_context=context, initializer=end_with_parent)
    outcomes: list[Outcome] = []
    try:
        with interrupts_held():
            futures = [pool.submit(_fly, config) for config in configs]
        for future in futures:
            outcome = future.result()
            if isinstance(outcome, _Refused):
                raise InputError(outcome.field, outcome.value, outcome.allowed)
            outcomes.append(outcome)
            if on_outcome is not None:
                on_outcome(outcome)
    except BrokenProcessPool:
        raise FlockError(
            f"a worker was killed after {len(outcomes)} trials; is there memory for {jobs} jobs?"
        ) from None
    finally:
        if len(outcomes) < len(configs):
            for worker in set(multiprocessing.active_children()) - others:
                worker.terminate()
        pool.shutdown(cancel_futures=True)
    return outcomes


def _models(config: RunConfig) -> tuple[str, ...]:
    return parse_models(config.model.model, config.mission.n_robots)


def _fly(config: RunConfig) -> Outcome | _Refused:
    """One trial, in a worker."""
    seed = config.trial.seed
    config = config.model_copy(update={"trial": config.trial.model_copy(update={"out": None})})
    try:
        return Outcome(seed=seed, summary=run(config=config).summary)
    except InputError as error:
        return _Refused(field=error.field, value=error.value, allowed=error.allowed)
    except Exception as error:  # noqa: BLE001 - nothing is swallowed: it is reported, counted, and the rest still flies
        return Outcome(seed=seed, summary=None, error=f"{type(error).__name__}: {error}")


@contextmanager
def interrupts_held() -> Generator[None]:
    """Hold back Ctrl-C while workers start: they inherit that for life, so that only the parent takes it.

    A terminal sends Ctrl-C to the whole group of processes, and each worker would print a traceback of its own.
    """
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_with_parent() -> None:
    """Let a worker end when its parent is gone, however that came about."""
    parent = multiprocessing.parent_process()
    assert parent is not None, "runs in workers only"

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
