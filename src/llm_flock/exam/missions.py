"""The second part of the exam: whole missions of a few teams, by the model alone and with what helps it.

Flown as `llm-flock compare` flies, with the protocol `flock`: with `--fallback hold`, robots only do what their
models answer; with `breaker`, geometry flies the robots of models that stay unusable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from llm_flock.exam.examinee import Setup
from llm_flock.experiments.compare import Row, build_cells, compare
from llm_flock.experiments.grid import Cell
from llm_flock.experiments.trial import TrialResult

TEAMS: tuple[tuple[str, int], ...] = (("triangle", 3), ("circle", 5), ("square", 8), ("circle", 10))
"""Shapes and sizes of the missions."""

FALLBACKS = ("hold", "breaker")
"""Without help, and with it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Missions:
    """The missions of one team with one fallback.

    Attributes:
        team: such as `circle 5`.
        fallback: `hold` or `breaker`.
        trials: number of missions, each from other starts.
        broken: missions that broke off by an error; they count as not formed.
        formed: of these.
        by_models: formed with no help from geometry.
        ratio: median of the rounds over the lower bound, of those that formed; None without any.
        violations: missions in which two robots were nearer than the safe distance.
        calls: mean of the model's calls in a mission; None where all broke off.
        cost_per_formed: money for each formed mission [US dollars]; None where none formed.
        own_waypoints: share of waypoints that the model gave, and that were flown as given; None without waypoints.
    """

    team: str
    fallback: str
    trials: int
    broken: int
    formed: int
    by_models: int
    ratio: float | None
    violations: int
    calls: float | None
    cost_per_formed: float | None
    own_waypoints: float | None


def fly_missions(
    setup: Setup, trials: int, *, jobs: int = 1, teams: Sequence[tuple[str, int]] = TEAMS
) -> list[Missions]:
    """Fly `trials` missions of each team with each fallback, the same starts for both.

    Budgets are shared out evenly, so that all missions together stay within them. Workers are spawned: a script that
    calls this needs its `if __name__ == "__main__":` guard.

    Raises:
        InputError: the model cannot be asked, or a number is out of its range.
    """
    share = max(1, trials * len(teams) * len(FALLBACKS))
    fields: dict[str, Any] = {
        name: getattr(setup, name)
        for name in ("model", "prompts", "frame", "answers", "base_url", "temperature", "model_seed")
    }
    fields |= {"reasoning_effort": setup.reasoning_effort, "max_answer_tokens": setup.max_answer_tokens}
    fields |= {"max_concurrent": setup.max_concurrent, "timeout_s": setup.timeout_s}
    fields["max_calls"] = None if setup.max_calls is None else max(1, setup.max_calls // share)
    fields["max_tokens"] = None if setup.max_tokens is None else max(1, setup.max_tokens // share)
    fields["max_cost"] = None if setup.max_cost is None else setup.max_cost / share
    given = {name: value for name, value in fields.items() if value is not None}
    cells = [cell for name in FALLBACKS for cell in build_cells(teams, ["flock"], fallback=name, **given)]
    spent: dict[int, float] = {}
    order = {id(cell): number for number, cell in enumerate(cells)}

    def note(cell: Cell, _: int, result: TrialResult) -> None:
        number = order[id(cell)]
        spent[number] = spent.get(number, 0.0) + result.spent.cost_usd

    rows = compare(cells, trials=trials, jobs=jobs, on_result=note)
    fallbacks = [name for name in FALLBACKS for _ in teams]
    return [_missions(row, name, spent.get(k, 0.0)) for k, (row, name) in enumerate(zip(rows, fallbacks, strict=True))]


def plain_missions(found: Sequence[Missions]) -> list[dict[str, Any]]:
    """As JSON values, numbers with six decimals."""
    return [{k: round(v, 6) if isinstance(v, float) else v for k, v in asdict(one).items()} for one in found]


def _missions(row: Row, fallback: str, cost_usd: float) -> Missions:
    formed = round(row.formed.value * row.trials)
    waypoints = sum(row.waypoints.values())
    return Missions(
        team=f"{row.shape} {row.n_robots}",
        fallback=fallback,
        trials=row.trials,
        broken=row.broken,
        formed=formed,
        by_models=round(row.by_models.value * row.trials),
        ratio=row.ratio,
        violations=row.violations,
        calls=None if row.calls is None else row.calls.value * row.n_robots,
        cost_per_formed=cost_usd / formed if formed else None,
        own_waypoints=row.waypoints.get("model", 0) / waypoints if waypoints else None,
    )
