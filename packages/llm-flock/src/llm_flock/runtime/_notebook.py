"""The progress of a run in a notebook: one line below the cell, redrawn while the team flies."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    from llm_flock.runtime._trial import TrialProgress

OnRound: TypeAlias = "Callable[[TrialProgress], None]"
"""Called after each round."""

PATIENCE_S = 0.5
"""A run that is over sooner shows no progress [s]: a hundred quick runs would fill the notebook with lines."""

REDRAW_S = 0.1
"""Shortest time between two drawings [s]."""


def in_notebook() -> bool:
    """Whether this process is a notebook's kernel; in a terminal, IPython has none."""
    ipython: Any = sys.modules.get("IPython")
    get_shell = getattr(ipython, "get_ipython", None)
    shell = None if get_shell is None else get_shell()
    return getattr(shell, "kernel", None) is not None


@contextmanager
def notebook_progress(label: str, on_round: OnRound | None = None) -> Generator[OnRound | None]:
    """In a notebook, a function to call after each round, which also calls `on_round`; elsewhere `on_round` itself."""
    if not in_notebook():
        yield on_round
        return
    line = _Line(label)

    def both(now: TrialProgress) -> None:
        line.show(now)
        if on_round is not None:
            on_round(now)

    try:
        yield both
    finally:
        line.end()


class _Line:
    """One line of output that is replaced by the next."""

    def __init__(self, label: str) -> None:
        self._label = label
        self._handle: Any = None
        self._last: TrialProgress | None = None
        self._next_s = time.monotonic() + PATIENCE_S

    def show(self, now: TrialProgress) -> None:
        """Draw the line, unless it was drawn just now."""
        self._last = now
        if time.monotonic() >= self._next_s:
            self._draw(now)
            self._next_s = time.monotonic() + REDRAW_S

    def end(self) -> None:
        """Draw the last state of what has been shown."""
        if self._handle is not None and self._last is not None:
            self._draw(self._last)

    def _draw(self, now: TrialProgress) -> None:
        display: Any = import_module("IPython.display")
        shown = display.HTML(progress_html(self._label, now))
        if self._handle is None:
            self._handle = display.display(shown, display_id=True)
        else:
            self._handle.update(shown)


def progress_html(label: str, now: TrialProgress) -> str:
    """A bar of the robots at their goals, and the figures of the round."""
    error = "" if now.error is None else f" · error {now.error:.2f}"
    cost = f" · {now.cost_usd:.4f} USD" if now.cost_usd else ""
    text = (
        f"{label} · round {now.round} · at goal {now.at_goal}/{now.n_robots} · plans {now.plans_in_use}{error} · "
        f"calls {now.model_calls} · tokens {now.tokens:,}{cost}"
    )
    return f'<progress value="{now.at_goal}" max="{max(1, now.n_robots)}"></progress> <code>{escape(text)}</code>'
