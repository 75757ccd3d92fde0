"""A row of the table of runs: the run, its outcome, and a thumbnail of its last round."""

from __future__ import annotations

from typing import Any

from llm_flock.printable import one_line
from llm_flock.record import DEAD, RunHistory, sentence
from llm_flock_view._figures.style import plan_look
from llm_flock_view._viewer.outcome import outcome, protocol_name
from llm_flock_view._viewer.recording import Recording, in_unit_square

MAX_DOTS = 250  # most robots of a thumbnail

FIGURES: tuple[tuple[str, str], ...] = (
    ("procrustes_mean", "Shape error [units]"),
    ("min_separation", "Smallest separation [units]"),
    ("plans_in_use", "Plans in use"),
    ("calls_rejected", "Calls refused"),
    ("calls_failed", "Calls failed"),
    ("tokens", "Tokens"),
    ("cost_usd", "Cost [$]"),
    ("messages_sent", "Messages"),
)
"""Figures of a result that runs are compared by, and their labels."""


def run_row(run: Recording) -> dict[str, Any]:
    """The table's row of a run; a run that is not ready has its name and the reason."""
    row: dict[str, Any] = {
        "key": run.key,
        "title": one_line(run.title),
        "open": run.open,
        "failure": None if run.failure is None else one_line(run.failure),
        "ready": run.ready,
        # A record that is being written, a link or a swarm cannot be deleted.
        "deletable": run.path is not None and not run.open and not run.path.is_symlink(),
    }
    if not run.ready:
        return row
    history = run.history
    result = history.result or {}
    found = outcome(history, over=not run.open)
    rounds, bound = history.last_round, _number(result.get("lower_bound_rounds"))
    took = _number(result.get("rounds_to_formed"))
    calls = _number(result.get("model_calls"))
    info = history.info
    return row | {
        "tone": found["tone"],
        "outcome": one_line(str(found["headline"])),
        "why": sentence(str(found["why"]).partition(". ")[0], 300) if found["why"] else "",
        "date": "" if info is None else one_line(info.created_at[:16].replace("T", " ")),
        "seed": None if info is None else info.seed,
        "loss": None if info is None else _number(info.config.get("links", {}).get("loss")),
        "deaths": sum(phase == DEAD for phase in history.states[rounds].phases),
        "protocol": one_line(protocol_name(history)),
        "model": "" if info is None else one_line(str(info.config.get("model", {}).get("model", ""))),
        "mission": one_line(", then ".join(part["text"] for part in found["missions"])),
        "rounds": rounds,
        "took": took,
        "bound": bound,
        "ratio": round(took / bound, 3) if took is not None and bound else None,
        "calls": history.rows[rounds].model_calls if calls is None else calls,
        "figures": [[label, _number(result.get(name))] for name, label in FIGURES],
        "thumbnail": _thumbnail(history),
    }


def _thumbnail(run: RunHistory) -> list[list[Any]]:
    """Places from 0 to 1 within the team's own width, and a colour, of each robot in the last round."""
    state = run.states[run.last_round]
    colours = ("#9a9a9a" if plan is None else plan_look(run.plan_numbers[plan]).fill for plan in state.plan_ids)
    return [[x, y, colour] for (x, y), colour in zip(in_unit_square(state.positions), colours, strict=True)][:MAX_DOTS]


def _number(value: object) -> float | None:
    return value if isinstance(value, int | float) and not isinstance(value, bool) else None
