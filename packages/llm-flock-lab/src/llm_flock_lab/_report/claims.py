"""The paper's published claims, one by one, each with a verdict computed from the trials of a sweep.

Line numbers are those of the paper's source. A claim about one model is weighed with the first model of the sweep, if
o3-mini was not flown; a claim that compares named models needs these.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import polars as pl
import scipy

from llm_flock.metrics import IN_SHAPE
from llm_flock.record import RunRecord, formed_in
from llm_flock_lab._experiments.paired import paired_shares
from llm_flock_lab._experiments.statistics import interval, mean_interval, wilson
from llm_flock_lab._report.results import Results, Team, TrialRow
from llm_flock_lab._report.sheets import Sheet

TEAMS = (Team(3, "triangle"), Team(6, "triangle"), Team(8, "square"), Team(10, "circle"))
"""The paper's teams (line 240)."""

FLIGHTS = (Team(3, "triangle"), Team(4, "square"), Team(5, "cross"), Team(5, "circle"))
"""The paper's flights (line 544)."""

STRONG, GENERAL = ("o3-mini", "deepseek"), ("claude", "llama", "qwen")
"""Parts of the names of the paper's models: those that it calls strong in reasoning, and the others."""

CONSISTENTLY, MOSTLY = 0.95, 0.5  # shares of trials that these words stand for, if the whole interval is above them
SETTLED = 10  # rounds at the end in which the error of a team that has converged does not rise
MOST_CELLS = 4  # cells that a verdict lists with their figures

REPRODUCED, NOT_REPRODUCED, UNDECIDED, UNTESTED = "reproduced", "not reproduced", "undecided", "cannot be tested"

Tested: TypeAlias = tuple[bool | None, str] | None
"""Whether a claim holds in a cell, None if trials do not decide it, and their figures; None where nothing was flown."""

Test: TypeAlias = "Callable[[PaperEvidence, Team], Tested]"

Verdict: TypeAlias = tuple[str, str]
"""One of the three words above, perhaps with what is missing, and the figures that it follows from."""

Figures: TypeAlias = Mapping[tuple[str, int], float]  # a figure by condition and seed


@dataclass(frozen=True, kw_only=True)
class PaperEvidence:
    """Results with the paper's teams: `protocol` has consensus, `reference` has none; and records of flights."""

    results: Results
    protocol: str
    reference: str
    flights: Sequence[RunRecord] = ()

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

    def errors(self, team: Team, models: Sequence[str], protocol: str | None = None) -> Figures:
        """Error at the end, mean over models [units]."""
        found: defaultdict[tuple[str, int], list[float]] = defaultdict(list)
        for model in models:
            for key, trial in self.trials(team, model, protocol).items():
                found[key] += [] if trial.error is None else [trial.error]
        return {key: sum(errors) / len(errors) for key, errors in found.items() if errors}

    def changes(self, team: Team) -> Figures:
        """Error at the end with consensus less that without [units]."""
        models = [self.stand_in]
        return _minus(self.errors(team, models), self.errors(team, models, self.reference))

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
        if not self.faulty_plan(trial, settled=False):
            return False
        errors = self.results.curves([trial], self.results.longest)[:, -SETTLED:]
        return bool(errors.size) and float(np.ptp(errors)) > 0.01 * (trial.figures["spacing"] or 1.0)


def _verdict(cells: Iterable[tuple[str, Tested]]) -> Verdict:
    """Reproduced if a claim holds in every cell that was flown; cells where it fails, or may fail, are named first."""
    tested = [(name, found) for name, found in cells if found is not None]
    if not tested:
        return f"{UNTESTED} without these teams", ""
    bad = [f"fails in {name}: {words}" for name, (holds, words) in tested if holds is False]
    open_ = [f"undecided in {name}: {words}" for name, (holds, words) in tested if holds is None]
    good = [f"{name}: {words}" for name, (holds, words) in tested if holds]
    parts = bad + open_ + (good if len(tested) <= MOST_CELLS else [f"holds in {len(good)} of {len(tested)} cells"])
    return NOT_REPRODUCED if bad else UNDECIDED if open_ else REPRODUCED, "; ".join(parts)


def _above(low: float | None, high: float | None, threshold: float = 0.0) -> bool | None:
    """Whether an interval is above a threshold; None if it contains the threshold, or has no ends."""
    return True if low is not None and low > threshold else False if high is not None and high < threshold else None


def _short(team: Team) -> str:
    return f"{team.shape} {team.n_robots}"


def _in_teams(test: Test, teams: Sequence[Team] = TEAMS) -> Callable[[PaperEvidence], Verdict]:
    return lambda evidence: _verdict((_short(team), test(evidence, team)) for team in teams)


def _in_shape(evidence: PaperEvidence, trial: TrialRow) -> bool:
    """Whether a team ended in the shape, whatever plans its robots had: the paper's measure is the error (236)."""
    return trial.error is not None and trial.error <= IN_SHAPE * trial.figures["spacing"]


def _share(
    of: Callable[[PaperEvidence, TrialRow], bool], words: str, *, least: float = MOSTLY, alone: bool = False
) -> Test:
    """A share of trials above the `least`; with consensus, or `alone` without."""

    def test(evidence: PaperEvidence, team: Team) -> Tested:
        trials = evidence.trials(team, evidence.stand_in, evidence.reference if alone else None).values()
        if not trials:
            return None
        share = wilson(sum(of(evidence, trial) for trial in trials), len(trials))
        return _above(share.low, share.high, least), f"{interval(share, 1, 100)} % {words}"

    return test


def _minus(first: Figures, second: Figures) -> Figures:
    return {key: first[key] - second[key] for key in first if key in second}


def _lower(differences: Figures, words: str = "error") -> Tested:
    """Whether differences are below 0, seed by seed."""
    mean = mean_interval(list(differences.values()))
    if mean is None:
        return None
    higher = _above(mean.low, mean.high)
    return None if higher is None else not higher, f"{words} {interval(mean, 2, signed=True)} units"


def _nearer(evidence: PaperEvidence, team: Team) -> Tested:
    return _lower(evidence.changes(team))


def _forms_and_is_nearer(evidence: PaperEvidence, team: Team) -> Tested:
    """More trials end in the shape, and their errors are lower: both on the same seeds, with intervals without 0."""
    first = evidence.trials(team, evidence.stand_in)
    second = evidence.trials(team, evidence.stand_in, evidence.reference)
    both, error = [key for key in first if key in second], _nearer(evidence, team)
    ends = [[_in_shape(evidence, trials[key]) for key in both] for trials in (first, second)]
    shares = paired_shares(*ends)
    if shares is None or error is None:
        return None
    more = _above(shares.difference.low, shares.difference.high)
    holds = None if None in (more, error[0]) and False not in (more, error[0]) else bool(more and error[0])
    return holds, f"in shape {interval(shares.difference, 1, 100, signed=True)} points, {error[1]}"


def _less_spread(evidence: PaperEvidence, team: Team) -> Tested:
    """Whether errors spread less, on the same seeds: the test of Pitman and of Morgan (both Biometrika, 1939)."""
    one, other = (evidence.errors(team, [evidence.stand_in], name) for name in (evidence.protocol, evidence.reference))
    table = np.array([(one[key], other[key]) for key in one if key in other]).reshape(-1, 2)
    if len(table) < 3:
        return None
    spread = table.std(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):  # where nothing differs there is no correlation
        r = float(np.corrcoef(table.sum(axis=1), table[:, 0] - table[:, 1])[0, 1])
    free = len(table) - 2
    p = float(scipy.special.stdtr(free, r * math.sqrt(free / max(1 - r * r, 1e-12))))
    return (
        True if p < 0.025 else False if p > 0.975 else None,
        f"standard deviation {spread[0]:.2f}, without {spread[1]:.2f}",
    )


def _grows(evidence: PaperEvidence) -> Verdict:
    """Whether the error of the largest team changes more than that of the smallest, seed by seed."""
    more = _minus(evidence.changes(TEAMS[-1]), evidence.changes(TEAMS[0]))
    return _verdict([(f"{_short(TEAMS[-1])} against {_short(TEAMS[0])}", _lower(more, "change of error"))])


def _converges(evidence: PaperEvidence) -> Verdict:
    """In every team with every model: half as far as at the start, and no farther than some rounds before the end."""
    results = evidence.results

    def test(team: Team, model: str) -> Tested:
        table = results.curves(list(evidence.trials(team, model).values()), results.longest)
        if len(table) < 2 or table.shape[1] <= SETTLED:
            return None
        before = table[:, 0] / 2, table[:, -1 - SETTLED]
        fell, rose = (mean_interval((table[:, -1] - errors).tolist()) for errors in before)
        holds = fell is not None and (fell.high or 0.0) < 0 and rose is not None and (rose.low or 0.0) <= 0
        return holds, f"mean error {table[:, 0].mean():.1f} at the start, {table[:, -1].mean():.2f} at the end"

    cells = [(team, model) for team in TEAMS for model in results.models]
    return _verdict((f"{_short(team)} with {model}", test(team, model)) for team, model in cells)


def _stronger(evidence: PaperEvidence) -> Verdict:
    """Whether the models that the paper calls strong end nearer to the shape than its others, seed by seed."""
    real = [name for name in evidence.results.models if not name.startswith("simulated:")]
    strong, general = (
        [name for name in real if any(part in name.lower() for part in parts)] for parts in (STRONG, GENERAL)
    )
    if not strong or not general:
        return f"{UNTESTED} without these models", ""
    return _in_teams(lambda one, team: _lower(_minus(one.errors(team, strong), one.errors(team, general))))(evidence)


def _happens(which: Callable[[PaperEvidence, TrialRow], bool]) -> Callable[[PaperEvidence], Verdict]:
    """A claim that something may happen: it does if a trial shows it. Where no trial of any protocol does, none can."""

    def judge(evidence: PaperEvidence) -> Verdict:
        shown = [trial for trial in evidence.results.trials if which(evidence, trial)]
        own = [trial for trial in shown if trial.cell.protocol == evidence.protocol]
        flown = sum(trial.cell.protocol == evidence.protocol for trial in evidence.results.trials)
        models = ", ".join(dict.fromkeys(trial.cell.model for trial in own))
        word = REPRODUCED if own else NOT_REPRODUCED if shown else f"{UNTESTED} without a model that errs so"
        return word, f"{len(own)} of {flown} trials{f', with {models}' if own else ''}"

    return judge


def team_of(record: RunRecord) -> Team:
    mission = record.mission.mission
    return Team(int(mission["n_robots"]), str(mission["shape"]))


def drones_of(record: RunRecord) -> str:
    """What flew, by its driver."""
    driver = dict(record.run.config.get("fleet") or {}).get("robot")
    return "drones" if driver in ("crazyflie", "mavlink") else "stand-ins"


def _flown(evidence: PaperEvidence) -> Verdict:
    """The paper's four flights, by their records; stand-in drones are no drones."""
    formed = {team_of(one): round for one in evidence.flights if (round := formed_in(one.result or {})) is not None}
    drones = {team_of(one) for one in evidence.flights if drones_of(one) == "drones"}
    words = "; ".join(f"{_short(team)} formed in round {formed[team]}" for team in FLIGHTS if team in formed)
    if drones & formed.keys() >= set(FLIGHTS):
        return REPRODUCED, words
    return f"{UNTESTED} without drones", f"stand-ins: {words}" if words else ""


class PaperClaim(NamedTuple):
    """A claim in other words than the paper's; those about teams `alone`, without consensus, hold for no protocol."""

    lines: str
    text: str
    judge: Callable[[PaperEvidence], Verdict]
    alone: str = ""


_alone = _share(lambda evidence, trial: not _in_shape(evidence, trial), "ended out of shape", alone=True)

_always = _share(_in_shape, "in shape", least=CONSISTENTLY)
_agree = _share(PaperEvidence.agreed, "with one plan", least=CONSISTENTLY)

CLAIMS = (
    PaperClaim("209", "Three robots consistently form a triangle", _in_teams(_always, TEAMS[:1])),
    PaperClaim("209", "They agree on one plan", _in_teams(_agree, TEAMS[:1])),
    PaperClaim("209", "Without it they mostly end uneven or collapsed", _in_teams(_alone, TEAMS[:1]), "baseline"),
    PaperClaim(
        "228", "Eight mostly form the square, ten the circle", _in_teams(_share(_in_shape, "in shape"), TEAMS[2:])
    ),
    PaperClaim(
        "456-510", "In every team more trials end in shape, and nearer, than without", _in_teams(_forms_and_is_nearer)
    ),
    PaperClaim("541", "Without consensus errors are significantly higher", _in_teams(_nearer)),
    PaperClaim("541", "They vary more from trial to trial", _in_teams(_less_spread)),
    PaperClaim("541", "The difference is larger in larger formations", _grows),
    PaperClaim("664, 746", "A strong model alone, without consensus, mostly fails", _in_teams(_alone), "baseline"),
    PaperClaim("253", "With every model, teams of every size converge and stay", _converges),
    PaperClaim("253, 288", "o3-mini, DeepSeek-R1 end nearer than Claude 3.5 Sonnet, Qwen-Max, Llama 3.1", _stronger),
    PaperClaim(
        "654", "A faulty plan may spread to all, who then form another shape", _happens(PaperEvidence.faulty_plan)
    ),
    PaperClaim(
        "676, 744", "Models that step at full speed may keep a team from resting", _happens(PaperEvidence.swinging)
    ),
    PaperClaim("270, 544", "Drones form a triangle, a square, a cross and a circle", _flown, "flights"),
)
"""The paper's qualitative claims, in the order of its sections."""


def claims_sheet(evidence: Sequence[PaperEvidence]) -> Sheet:
    """Every claim under each protocol with consensus; those about teams without it, and about flights, once."""
    rows: list[tuple[str, ...]] = []
    for claim in CLAIMS:
        for one in evidence[:1] if claim.alone else evidence:
            rows.append((claim.text, claim.lines, claim.alone or one.protocol, *claim.judge(one)))
    note = (
        f"Lines are the paper's. Claims about one model are weighed with {evidence[0].stand_in}. More, higher, lower: "
        "on the same seeds, the 95 % interval without 0 (Newcombe's for shares, Student's for means; for spreads, the "
        "test of Pitman and Morgan). Mostly, consistently: the whole interval above one half, or above "
        f"{100 * CONSISTENTLY:.0f} %. In shape: an error at the end of at most 10 % of the spacing, with any plans. "
        f"To converge and stay: the error falls by half, and does not rise in the last {SETTLED} rounds. A claim is "
        "reproduced if it holds in every cell, and undecided where the interval contains what it is compared with."
    )
    if evidence[0].results.simulated:
        note += " The models are simulated: the verdicts are about protocols, not about language models."
    header = ("claim", "lines", "protocol", "verdict", "figures")
    return Sheet(title="The paper's claims", header=header, rows=tuple(rows), words=len(header), note=note)
