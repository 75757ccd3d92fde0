"""One trial of an experiment, from its specification to its result."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeAlias

import msgspec
import numpy as np
import scipy

from llm_flock import runtime
from llm_flock.arrays import Points
from llm_flock.cancellation import is_cancelled
from llm_flock.errors import InputError
from llm_flock.llm import CallLane, Spent, habits_of
from llm_flock.mission import Mission
from llm_flock.record import Entry, MetricsRow, PlanInfo, State, SummaryMessage
from llm_flock.runtime import RECORD_NAME, run_async
from llm_flock.user_code import describe_exception
from llm_flock_lab._experiments.grid import Earlier, TrialSpec

KeepRecords: TypeAlias = Literal["all", "failed", "none"]  # trials whose record is kept
NO_WAY = 1e6  # length that stands for a way that does not exist [units]

FORMAT = 1  # version of the files in `trials/`


class TrialResult(msgspec.Struct, frozen=True, kw_only=True):
    """The result of one trial, as `trials/ID.json` holds it; id, cell and axes are those of its `TrialSpec`."""

    id: str
    cell: str
    axes: dict[str, str]
    config: dict[str, Any]
    summary: dict[str, Any] | None  # None where it broke off before it began
    rounds: dict[str, list[float | int | None]]  # columns of `tables.ROUNDS` but the first
    error: str | None
    cut: bool  # by the sweep's budget; flown again as soon as there is one
    simulated: bool  # whether any language model was a stand-in
    code: str
    record: str | None = None  # relative to the results directory
    earlier: tuple[Earlier, ...] = ()
    format: int = FORMAT

    @property
    def formed(self) -> bool:
        """Whether the formation was built; false for a trial that broke off."""
        return self.error is None and self.summary is not None and bool(self.summary["formed"])

    @property
    def stopped(self) -> str:
        return "failed" if self.summary is None or self.error is not None else str(self.summary["stopped"])

    @property
    def spent(self) -> Spent:
        found = self.summary or {}
        return Spent(
            calls=found.get("model_calls", 0), tokens=found.get("tokens", 0), cost_usd=found.get("cost_usd") or 0.0
        )

    def as_earlier(self) -> tuple[Earlier, ...]:
        """This try and those before it, for the one that replaces it."""
        cost = 0.0 if self.summary is None else self.summary["cost_usd"]
        spent = self.spent
        mine = Earlier(stopped=self.stopped, model_calls=spent.calls, tokens=spent.tokens, cost_usd=cost)
        return (*self.earlier, mine)


@dataclass
class _Metrics:
    """Collects the figures of each round and of the whole trial from the entries of its record."""

    mission: Mission
    rows: list[MetricsRow] = field(default_factory=list[MetricsRow])
    result: Mapping[str, Any] | None = None
    plans: dict[str | None, Points] = field(default_factory=dict[str | None, Points])
    track: list[Points] = field(default_factory=list[Points])  # positions at the start and now
    followed: list[str | None] = field(default_factory=list[str | None])
    flown: float = 0.0

    def distances(self) -> dict[str, float | None]:
        """Distance flown by all robots, and the least from their starts to one plan that stands still [units]."""
        least, places = None, self.plans.get(self.followed[0]) if len({*self.followed}) == 1 else None
        if places is not None and self.mission.velocity is None:
            ways = np.minimum(self.mission.shortest_ways(self.track[0], places), NO_WAY)
            sum_of_ways = float(ways[scipy.optimize.linear_sum_assignment(ways)].sum())
            least = sum_of_ways if sum_of_ways < NO_WAY else None
        return {"distance_flown": self.flown, "distance_least": least}

    def write(self, entry: Entry) -> None:
        """Keep the figures; the summary also comes where a run broke off."""
        if isinstance(entry, State):
            here, self.followed = np.array(entry.positions), entry.plan_ids
            self.flown += float(np.linalg.norm(here - self.track[-1], axis=1).sum()) if self.track else 0.0
            self.track[1:] = [here]
        elif isinstance(entry, PlanInfo):
            self.plans[entry.plan_id] = np.array(entry.points)
        elif isinstance(entry, MetricsRow):
            self.rows.append(entry)
        elif isinstance(entry, SummaryMessage):
            self.result = entry.result


async def fly(
    spec: TrialSpec,
    *,
    lane: CallLane | None = None,
    keep: KeepRecords = "none",
    scratch: Path | None = None,
) -> tuple[TrialResult, Path | None]:
    """Fly one trial; returns its result, and the path of its record in `scratch` if that is to be kept.

    The result reports any exception in it. Without `scratch` nothing is stored, and an `InputError` is raised.
    """
    out = None
    if scratch is not None:
        shutil.rmtree(scratch, ignore_errors=True)
        out = None if keep == "none" else str(scratch)
    lane = lane or CallLane()
    config = spec.config.model_copy(update={"trial": spec.config.trial.model_copy(update={"out": out})})
    metrics, error = _Metrics(spec.config.mission), None
    try:
        await run_async(config=config, sink=metrics, lane=lane, progress=False, trace=False)
    except (Exception, asyncio.CancelledError) as reason:  # it is stored, counted and shown
        if (scratch is None and isinstance(reason, InputError)) or (
            isinstance(reason, asyncio.CancelledError) and is_cancelled()
        ):
            raise
        error = describe_exception(reason)
    summary = None if metrics.result is None else {**metrics.result, "record": None, **metrics.distances()}
    formed = summary is not None and summary["formed"] and error is None
    record = None if out is None or (formed and keep == "failed") else Path(out) / RECORD_NAME
    record = record if record is not None and record.exists() else None
    result = TrialResult(
        id=spec.id,
        cell=spec.cell,
        axes=dict(spec.axes),
        config=spec.config.model_dump(mode="json"),
        summary=summary,
        rounds=_columns(metrics.rows),
        error=error,
        cut=error is None and lane.cut and summary is not None,  # also one that formed without its last answers
        simulated=any(habits_of(model).simulated for model in spec.models) or bool(summary and summary["simulated"]),
        code="" if scratch is None else code_version(),
        record=None if record is None else f"records/{spec.id}.mcap",
        earlier=spec.earlier,
    )
    return result, record


def _columns(rows: list[MetricsRow]) -> dict[str, list[float | int | None]]:
    """The columns of `tables.ROUNDS` but the first, in their order."""

    def closest(row: MetricsRow) -> float | None:
        return min((d for d in (row.min_separation, row.segment_separation) if d is not None), default=None)

    return {
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


@cache
def code_version() -> str:
    """Version of this package, and revision of its checkout where it runs from one; read once in each process."""
    version, revision = runtime.versions()["llm-flock"], runtime.git_revision()
    return version if revision is None else f"{version}+g{revision[:12]}{'.dirty' if '+' in revision else ''}"
