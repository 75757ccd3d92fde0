"""One trial of a sweep, from its specification to what is kept of it."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from llm_flock.experiments.store import Earlier, StoredTrial
from llm_flock.experiments.sweep_file import KeepRecords, TrialSpec
from llm_flock.experiments.tables import ROUNDS
from llm_flock.llm.providers import parse_model
from llm_flock.llm.sharing import Lane
from llm_flock.record.schema import MetricsRow
from llm_flock.record.writer import NullWriter
from llm_flock.runtime import versions
from llm_flock.runtime.api import RECORD_NAME, run_async
from llm_flock.runtime.trial import TrialProgress


@dataclass(frozen=True, slots=True, kw_only=True)
class Flown:
    """A trial that has been flown.

    Attributes:
        trial: what is kept of it.
        record: its record, where it is to be kept, in the folder for what is not yet finished.
    """

    trial: StoredTrial
    record: Path | None


@dataclass
class _Book(NullWriter):
    """Keeps what the tables need: the figures of each round, and of the whole."""

    rows: list[MetricsRow] = field(default_factory=list[MetricsRow])
    result: Mapping[str, Any] | None = None

    def metrics(self, row: MetricsRow) -> None:
        """The figures of one round."""
        self.rows.append(row)

    def summary(self, result: Mapping[str, Any]) -> None:
        """What the run reports, also where it broke off."""
        self.result = result


async def fly(
    spec: TrialSpec,
    *,
    lane: Lane,
    keep: KeepRecords,
    scratch: Path,
    earlier: tuple[Earlier, ...] = (),
    on_round: Callable[[TrialProgress], None] | None = None,
) -> Flown:
    """Fly one trial. Whatever breaks it off is reported, and counts; only an interruption goes through.

    Args:
        spec: the trial.
        lane: the way to what all trials share.
        keep: trials whose record is kept.
        scratch: folder for the record while it is written; whatever is in it is deleted first.
        earlier: tries before this one.
        on_round: told after each round.

    Raises:
        asyncio.CancelledError: the sweep is being stopped.
    """
    shutil.rmtree(scratch, ignore_errors=True)
    out = None if keep == "none" else str(scratch)
    config = spec.config.model_copy(update={"trial": spec.config.trial.model_copy(update={"out": out})})
    book, broken = _Book(), None
    try:
        await run_async(config=config, sink=book, lane=lane, on_round=on_round)
    except Exception as error:  # noqa: BLE001 - nothing is swallowed: it is stored, counted and shown
        broken = f"{type(error).__name__}: {error}"
    summary = None if book.result is None else {**book.result, "record": None}
    formed = summary is not None and summary["formed"] and broken is None
    record = scratch / RECORD_NAME
    kept = record if record.exists() and (keep == "all" or not formed) else None
    trial = StoredTrial(
        id=spec.id,
        cell=spec.cell,
        axes=dict(spec.axes),
        config=spec.config.model_dump(mode="json"),
        summary=summary,
        rounds=round_columns(book.rows),
        error=broken,
        cut=broken is None and lane.cut and summary is not None and summary["stopped"] == "budget",
        simulated=any(parse_model(model).kind == "simulated" for model in spec.models)
        or bool(summary and summary["simulated"]),
        code=code_version(),
        record=None if kept is None else f"records/{spec.id}.mcap",
        earlier=earlier,
    )
    return Flown(trial=trial, record=kept)


def round_columns(rows: list[MetricsRow]) -> dict[str, list[float | int | None]]:
    """The columns of `tables.ROUNDS` but the first, from the figures of all rounds."""

    def closest(row: MetricsRow) -> float | None:
        known = [d for d in (row.min_separation, row.segment_separation) if d is not None]
        return min(known, default=None)

    columns: dict[str, list[float | int | None]] = {
        "round": [row.round for row in rows],
        "error": [row.procrustes_mean for row in rows],
        "error_squared": [row.procrustes_mean_squared for row in rows],
        "min_separation": [closest(row) for row in rows],
        "plans_in_use": [row.plans_in_use for row in rows],
        "distinct_goals": [row.distinct_goals for row in rows],
        "at_goal": [row.robots_at_goal for row in rows],
        "calls": [row.model_calls for row in rows],
        "tokens": [row.tokens for row in rows],
        "cost_usd": [row.cost_usd for row in rows],
    }
    assert tuple(columns) == tuple(column.name for column in ROUNDS[1:])
    return columns


@cache
def code_version() -> str:
    """Version of this package, and revision of its checkout where it runs from one; asked for once a process."""
    version, revision = versions.versions()["llm-flock"], versions.git_revision()
    return version if revision is None else f"{version}+g{revision[:12]}{'.dirty' if '+' in revision else ''}"
