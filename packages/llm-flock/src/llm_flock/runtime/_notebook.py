"""The progress of a run in a notebook: one line below the cell, redrawn while the team flies."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any

from llm_flock.record import Guarded

if TYPE_CHECKING:
    from llm_flock.runtime._trial import TrialProgress

PATIENCE_S = 0.5  # shorter runs show no progress [s]: a hundred of them would fill the notebook with lines
REDRAW_S = 0.1  # shortest time between two drawings [s]


def in_notebook() -> bool:
    """Whether this process is a notebook's kernel; in a terminal, IPython has none."""
    ipython: Any = sys.modules.get("IPython")
    get_shell = getattr(ipython, "get_ipython", None)
    shell = None if get_shell is None else get_shell()
    return getattr(shell, "kernel", None) is not None


@contextmanager
def notebook_progress(
    label: str, on_round: Callable[[TrialProgress], None] | None = None
) -> Generator[Callable[[TrialProgress], None] | None]:
    """In a notebook, a function to call after each round, which also calls `on_round`; elsewhere `on_round` itself."""
    if not in_notebook():
        yield on_round
        return
    display: Any = import_module("IPython.display")
    handle: Any = None
    last: TrialProgress | None = None
    due = time.monotonic() + PATIENCE_S

    def draw(now: TrialProgress) -> None:
        nonlocal handle
        shown = display.HTML(progress_html(label, now))
        if handle is None:
            handle = display.display(shown, display_id=True)
        else:
            handle.update(shown)

    draw_line = Guarded("line of progress", draw, {})

    def show(now: TrialProgress) -> None:
        nonlocal last, due
        last = now
        if time.monotonic() >= due:
            draw_line(now)
            due = time.monotonic() + REDRAW_S
        if on_round is not None:
            on_round(now)

    try:
        yield show
    finally:
        if handle is not None and last is not None:
            draw_line(last)


def progress_html(label: str, now: TrialProgress) -> str:
    """A bar of the robots at their goals, and the figures of the round."""
    text = escape(f"{label} · {now.text}")
    return f'<progress value="{now.at_goal}" max="{max(1, now.n_robots)}"></progress> <code>{text}</code>'
