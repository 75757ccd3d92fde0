"""The paper's published claims, one by one, each with a verdict computed from the trials of a sweep.

Line numbers are those of the paper's source. A claim about one model is weighed with the first model of the sweep, if
o3-mini was not flown; a claim that compares named models needs these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import polars as pl
from numpy.typing import NDArray

from llm_flock.record import RunRecord, formed_in
from llm_flock_lab._experiments.paired import paired_shares
from llm_flock_lab._experiments.statistics import Estimate, interval, mean_interval, wilson
from llm_flock_lab._report.results import Results, Team, TrialRow
from llm_flock_lab._report.sheets import Sheet

TEAMS = (Team(3, "triangle"), Team(6, "triangle"), Team(8, "square"), Team(10, "circle"))
"""The paper's teams (line 240)."""

FLIGHTS = (Team(3, "triangle"), Team(4, "square"), Team(5, "cross"), Team(5, "circle"))
"""The paper's flights (line 544)."""

STRONG, GENERAL = ("o3-mini", "deepseek"), ("claude", "llama", "qwen")
"""Parts of the names of the paper's models: those that it calls strong in reasoning, and the others."""

CONSISTENTLY, MOSTLY = 0.95, 0.5
"""Shares of trials that these words stand for: at least the first, and surely (the whole interval) over the second."""

SETTLED = 10
"""Rounds at the end in which the error of a team that has converged does not rise."""

MOST_CELLS = 4
"""Cells that a verdict lists with their figures."""

REPRODUCED, NOT_REPRODUCED, UNTESTED = "reproduced", "not reproduced", "cannot be tested"

Tested: TypeAlias = tuple[bool, str] | None
"""Whether a claim holds in a cell, and the figures that say so; None where nothing was flown."""


class Verdict(NamedTuple):
    """One of the three words above, perhaps with what is missing, and the figures that it follows from."""

    word: str
    found: str


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """Results with the paper's teams: `protocol` has consensus, `reference` has none; and records of flights."""

    results: Results
    protocol: str
    reference: str
    flights: Sequence[RunRecord] = ()

    @property
    def teams(self) -> tuple[Team, ...]:
        return tuple(team for team in TEAMS if team in self.results.teams)

    @property
    def stand_in(self) -> str:
        """The model that stands for the one of the paper's figures."""
        return next((name for name in self.results.models if STRONG[0] in name), self.results.models[0])

    def trials(self, team: Team, model: str, protocol: str | None = None) -> dict[tuple[str, int], TrialRow]:
        """Trials by condition and seed."""
        cells = self.results.cells.items()
        wanted = (team, model, protocol or self.protocol)
        found = [trial for cell, own in cells if (cell.team, cell.model, cell.protocol) == wanted for trial in own]
        return {(trial.cell.condition, trial.seed): trial for trial in found}

    def errors(self, team: Team, *models: str, protocol: str | None = None) -> dict[tuple[str, int], float]:
        """Error at the end by condition and seed, mean over models [units]."""
        found: dict[tuple[str, int], list[float]] = {}
        for model in models:
            for key, trial in self.trials(team, model, protocol).items():
                found.setdefault(key, []).extend([] if trial.error is None else [trial.error])
        return {key: sum(errors) / len(errors) for key, errors in found.items() if errors}

    @cached_property
    def endings(self) -> Mapping[str, Mapping[str, Any]]:
        """The last row of every trial that has rounds."""
        rows = self.results.rounds.sort("round", maintain_order=True).group_by("trial").agg(pl.all().last())
        return {row["trial"]: row for row in rows.iter_rows(named=True)}

    def agreed(self, trial: TrialRow) -> bool:
        return self.endings.get(trial.id, {}).get("plans_in_use") == 1

    def faulty_plan(self, trial: TrialRow, *, settled: bool = True) -> bool:
        """Whether a team did not form though every robot stood (or not, if not `settled`) at its place of one plan."""
        end, n = self.endings.get(trial.id, {}), trial.cell.team.n_robots
        there = end.get("distinct_goals") == n and (end["at_goal"] == n) == settled
        return there and self.agreed(trial) and not trial.formed

    def swinging(self, trial: TrialRow) -> bool:
        """Whether a team with one plan never came to rest: its error still moves in the last rounds."""
        errors = self.results.curves([trial], self.results.longest)[:, -SETTLED:]
        moved = bool(errors.size) and float(np.ptp(errors)) > 0.01 * trial.figures["spacing"]
        return moved and self.faulty_plan(trial, settled=False)


def _verdict(cells: Iterable[tuple[str, Tested]]) -> Verdict:
    """Reproduced if a claim holds in every cell that was flown; cells where it fails are named first."""
    tested = [(name, found) for name, found in cells if found is not None]
    if not tested:
        return Verdict(f"{UNTESTED} without these teams", "")
    bad = [f"fails in {name}: {words}" for name, (holds, words) in tested if not holds]
    good = [f"{name}: {words}" for name, (holds, words) in tested if holds]
    parts = bad + (good if len(tested) <= MOST_CELLS else [f"holds in {len(good)} of {len(tested)} cells"])
    return Verdict(NOT_REPRODUCED if bad else REPRODUCED, "; ".join(parts))


def _short(team: Team) -> str:
    return f"{team.shape} {team.n_robots}"


def _in_teams(test: Callable[[Evidence, Team], Tested], teams: Sequence[Team] = TEAMS) -> Callable[[Evidence], Verdict]:
    return lambda evidence: _verdict((_short(team), test(evidence, team)) for team in teams)


def _share(
    evidence: Evidence,
    team: Team,
    *,
    of: Callable[[Evidence, TrialRow], bool] = lambda evidence, trial: trial.formed,
    words: str = "formed",
    least: float | None = None,
    alone: bool = False,
) -> Tested:
    """A share of trials: at least so large, or over one half; with consensus, or `alone` without."""
    trials = evidence.trials(team, evidence.stand_in, evidence.reference if alone else None).values()
    if not trials:
        return None
    share = wilson(sum(of(evidence, trial) for trial in trials), len(trials))
    holds = (share.low or 0.0) > MOSTLY if least is None else share.value >= least
    return holds, f"{interval(share, 1, 100)} % {words}"


_alone = partial(_share, of=lambda evidence, trial: not trial.formed, words="did not form", alone=True)


def _common(first: Mapping[Any, float], second: Mapping[Any, float]) -> NDArray[np.float64]:
    """Figures of the seeds that both have, shape (k, 2)."""
    return np.array([(first[key], second[key]) for key in first if key in second], dtype=np.float64).reshape(-1, 2)


def _pairs(evidence: Evidence, team: Team) -> NDArray[np.float64]:
    """Errors with consensus and without on the same seeds, shape (k, 2) [units]."""
    model = evidence.stand_in
    return _common(evidence.errors(team, model), evidence.errors(team, model, protocol=evidence.reference))


def _lower(table: NDArray[np.float64], words: str = "error") -> Tested:
    """Whether the first column is lower than the second, pair by pair."""
    difference = mean_interval((table[:, 0] - table[:, 1]).tolist())
    return None if difference is None else (
        _below_zero(difference), f"{words} {interval(difference, 2, signed=True)} units"
    )  # fmt: skip


def _below_zero(difference: Estimate) -> bool:
    return difference.high is not None and difference.high < 0


def _forms_and_is_nearer(evidence: Evidence, team: Team) -> Tested:
    """More trials form, and the error at the end is lower: both on the same seeds, with intervals without 0."""
    first = evidence.trials(team, evidence.stand_in)
    second = evidence.trials(team, evidence.stand_in, evidence.reference)
    both, error = [key for key in first if key in second], _lower(_pairs(evidence, team))
    shares = paired_shares([first[key].formed for key in both], [second[key].formed for key in both])
    if shares is None or error is None:
        return None
    more = (shares.difference.low or 0.0) > 0
    return more and error[0], f"formed {interval(shares.difference, 1, 100, signed=True)} points, {error[1]}"


def _less_spread(evidence: Evidence, team: Team) -> Tested:
    """Whether squared distances from the own mean are smaller, pair by pair."""
    table = _pairs(evidence, team)
    if len(table) < 2:
        return None
    squares = (table - table.mean(axis=0)) ** 2
    smaller = mean_interval((squares[:, 0] - squares[:, 1]).tolist())
    one, other = table.std(axis=0, ddof=1).tolist()
    return smaller is not None and _below_zero(smaller), f"standard deviation {one:.2f}, without {other:.2f}"


def _grows(evidence: Evidence) -> Verdict:
    """Whether the largest team gains more than the smallest, seed by seed."""
    gains: list[dict[Any, float]] = []
    for team in (TEAMS[0], TEAMS[-1]):
        with_it = evidence.errors(team, evidence.stand_in)
        without = evidence.errors(team, evidence.stand_in, protocol=evidence.reference)
        gains.append({key: with_it[key] - without[key] for key in with_it if key in without})
    few, many = gains
    return _verdict(
        [(f"{_short(TEAMS[-1])} against {_short(TEAMS[0])}", _lower(_common(many, few), "change of error"))]
    )


def _converges(evidence: Evidence) -> Verdict:
    """In every team with every model: nearer than at the start, and no farther than some rounds before the end."""
    results = evidence.results

    def test(team: Team, model: str) -> Tested:
        table = results.curves(list(evidence.trials(team, model).values()), results.longest)
        if len(table) < 2 or table.shape[1] <= SETTLED:
            return None
        rose = mean_interval((table[:, -1] - table[:, -1 - SETTLED]).tolist())
        fell = _lower(table[:, [-1, 0]])
        holds = fell is not None and fell[0] and rose is not None and (rose.low is None or rose.low <= 0)
        return holds, f"mean error {table[:, 0].mean():.1f} at the start, {table[:, -1].mean():.2f} at the end"

    cells = [(team, model) for team in evidence.teams for model in results.models]
    return _verdict((f"{_short(team)} with {model}", test(team, model)) for team, model in cells)


def _stronger(evidence: Evidence) -> Verdict:
    """Whether the models that the paper calls strong end nearer to the shape than its others, seed by seed."""
    real = [name for name in evidence.results.models if not name.startswith("simulated:")]
    strong, general = ([name for name in real if any(part in name.lower() for part in parts)]
                       for parts in (STRONG, GENERAL))  # fmt: skip
    if not strong or not general:
        return Verdict(f"{UNTESTED} without these models", "")
    return _in_teams(lambda one, team: _lower(_common(one.errors(team, *strong), one.errors(team, *general))))(evidence)


def _happens(which: Callable[[Evidence, TrialRow], bool]) -> Callable[[Evidence], Verdict]:
    """A claim that something may happen: it does if a trial shows it. Where no trial of any protocol does, none can."""

    def judge(evidence: Evidence) -> Verdict:
        shown = [trial for trial in evidence.results.trials if which(evidence, trial)]
        own = [trial for trial in shown if trial.cell.protocol == evidence.protocol]
        flown = sum(trial.cell.protocol == evidence.protocol for trial in evidence.results.trials)
        models = ", ".join(dict.fromkeys(trial.cell.model for trial in own))
        word = REPRODUCED if own else NOT_REPRODUCED if shown else f"{UNTESTED} without a model that errs so"
        return Verdict(word, f"{len(own)} of {flown} trials{f', with {models}' if own else ''}")

    return judge


def team_of(record: RunRecord) -> Team:
    mission = record.mission.mission
    return Team(int(mission["n_robots"]), str(mission["shape"]))


def _flown(evidence: Evidence) -> Verdict:
    """The paper's four flights, by their records; stand-in drones are no drones."""
    formed = {team_of(one): formed_in(one.result or {}) for one in evidence.flights}
    real = {team_of(one) for one in evidence.flights if _with_drones(one) and formed[team_of(one)] is not None}
    shown = [f"{_short(team)} in round {formed[team]}" for team in FLIGHTS if formed.get(team) is not None]
    words = "; ".join(shown)
    if real >= set(FLIGHTS):
        return Verdict(REPRODUCED, words)
    return Verdict(f"{UNTESTED} without drones", f"stand-ins formed: {words}" if words else "")


def _with_drones(record: RunRecord) -> bool:
    return dict(record.run.config.get("fleet") or {}).get("robot") in ("crazyflie", "mavlink")


class Claim(NamedTuple):
    """A claim in other words than the paper's; those about teams `alone`, without consensus, hold for no protocol."""

    lines: str
    text: str
    judge: Callable[[Evidence], Verdict]
    alone: str = ""


_always = partial(_share, least=CONSISTENTLY)
_one_plan = partial(_always, of=Evidence.agreed, words="with one plan")
_nearer: Callable[[Evidence, Team], Tested] = lambda evidence, team: _lower(_pairs(evidence, team))  # noqa: E731

CLAIMS = (
    Claim("209", "Three robots with consensus consistently form the triangle", _in_teams(_always, TEAMS[:1])),
    Claim("209", "They agree on one plan by the end", _in_teams(_one_plan, TEAMS[:1])),
    Claim("209", "Without it they mostly end uneven or collapsed", _in_teams(_alone, TEAMS[:1]), "baseline"),
    Claim("228", "With consensus eight mostly form the square, ten the circle", _in_teams(_share, TEAMS[2:])),
    Claim(
        "456, 474, 493, 510",
        "In every team more trials form with consensus than without, and end nearer to the shape",
        _in_teams(_forms_and_is_nearer),
    ),
    Claim("541", "Without consensus errors are significantly higher", _in_teams(_nearer)),
    Claim("541", "They vary more from trial to trial", _in_teams(_less_spread)),
    Claim("541", "The difference is larger in larger formations", _grows),
    Claim("668, 743", "A strong model alone, without consensus, mostly fails", _in_teams(_alone), "baseline"),
    Claim("253", "With every model, teams of every size converge and stay", _converges),
    Claim(
        "253, 288, 539",
        "o3-mini and DeepSeek-R1 end nearer than Claude 3.5 Sonnet, Qwen-Max and Llama 3.1",
        _stronger,
    ),
    Claim("655", "A faulty plan may spread to all, who then form another shape", _happens(Evidence.faulty_plan)),
    Claim(
        "677, 741", "Models that step at full speed may keep a team from coming to rest", _happens(Evidence.swinging)
    ),
    Claim("270, 544", "Drones form a triangle, a square, a cross and a circle", _flown, "flights"),
)
"""The paper's qualitative claims, in the order of its sections."""


def claims_sheet(evidence: Sequence[Evidence]) -> Sheet:
    """Every claim under each protocol with consensus; those about teams without it, and about flights, once."""
    rows: list[tuple[str, ...]] = []
    for claim in CLAIMS:
        for one in evidence[:1] if claim.alone else evidence:
            rows.append((claim.text, claim.lines, claim.alone or one.protocol, *claim.judge(one)))
    note = (
        "Lines are those of the paper's source. Claims about one model are weighed with "
        f"{evidence[0].stand_in}. More, higher, lower: on the same seeds, the 95 % interval without 0 (Newcombe's for "
        "shares, Student's for means). Mostly: the whole 95 % interval above one half. Consistently: in at least "
        f"{100 * CONSISTENTLY:.0f} % of the trials. To converge and stay: the error falls from the start, and does not rise "
        f"in the last {SETTLED} rounds. A claim is reproduced if it holds in every cell."
    )
    if evidence[0].results.simulated:
        note += " The models are simulated: the verdicts are about protocols, not about language models."
    header = ("claim", "lines", "protocol", "verdict", "figures")
    return Sheet(title="The paper's claims", header=header, rows=tuple(rows), words=len(header), note=note)
