"""The paper's figures from the trials of a sweep: errors over time, snapshots, its two failures, and its flights."""

# Matplotlib's types leave **kwargs open.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice

import numpy as np
from matplotlib.figure import Figure

from llm_flock.metrics import ShapeTarget
from llm_flock.record import Cause, PlanInfo, RunRecord
from llm_flock_lab._report.claims import FLIGHTS, TEAMS, PaperEvidence, drones_of, team_of
from llm_flock_lab._report.drawings import ReportDrawing, draw_bands
from llm_flock_lab._report.findings import INTERVAL
from llm_flock_lab._report.gallery import Failure, record_of, story
from llm_flock_lab._report.results import Results, Team, TrialRow
from llm_flock_view._figures.charts import PAGE, frame, new_figure
from llm_flock_view._figures.figures import sheet
from llm_flock_view._figures.style import FAINT, INK, house_style, model_names, plan_looks

STEPS, LONGER_STEPS = (0, 4, 7, 10), (0, 4, 8, 12)
"""Rounds of the paper's snapshots; the second are those of six robots."""

FLIGHT_STEPS = (0, 4, 7, 12)
FAILED_STEP = 19
"""Of the paper's first failure; its second is shown over four rounds."""

CONSENSUS = ("paper", "released", "paper-literal", "flock")  # protocols with consensus, the paper's first
MOST_READ = 12  # records that are read in search of a failure


def evidence_of(results: Results, reference: str, flights: Sequence[RunRecord]) -> list[PaperEvidence]:
    """For every protocol with consensus that was flown with one of the paper's teams, where the baseline was too."""
    if reference != "baseline" or not set(TEAMS) & set(results.teams):
        return []
    names = [name for name in CONSENSUS if name in results.protocols]
    return [PaperEvidence(results=results, protocol=name, reference=reference, flights=flights) for name in names]


def draw_paper(evidence: Sequence[PaperEvidence], fly_again: bool) -> Iterator[ReportDrawing]:
    """Errors by both formulas, a curve for each model; snapshots with and without consensus; the flights."""
    for first in evidence[:1]:
        protocols = [*(one.protocol for one in evidence), first.reference]
        teams = [team for team in TEAMS if team in first.results.teams]
        for name, formula, line in (
            ("error", "mean distance to the ideal shape [units]", 236),
            ("error_squared", "mean squared distance to it [units²]", 637),
        ):
            words = (
                f"By the formula of line {line}: mean of a cell's trials after each round, and its {INTERVAL}. A row "
                f"for each protocol; {first.reference} has no consensus. Above 1 the scale is logarithmic. A trial "
                "that ended early keeps its last error."
            )
            figure = draw_bands(first.results, teams, protocols, formula, name)
            title = f"Error with and without consensus, {formula.partition(' [')[0]}"
            yield _drawing(name.replace("_", "-"), title, words, figure, plate=False)
        yield from (drawing for team in teams for drawing in _snapshots(first, team, fly_again))
        yield from _influence(first, fly_again)
        flown = {team_of(record): record for record in first.flights}
        found = [(team, flown[team]) for team in FLIGHTS if team in flown]
        rows = [(f"{team.shape}, {team.n_robots} {drones_of(one)}", one, FLIGHT_STEPS) for team, one in found]
        if rows:
            words = "By the records of the flights (line 544). One that ended earlier shows its last round."
            yield _drawing("flights", "The paper's four flights", words, sheet(rows))


def _drawing(name: str, title: str, caption: str, figure: Figure, *, plate: bool = True) -> ReportDrawing:
    return ReportDrawing(
        name=f"paper-{name}", section="paper", title=title, caption=caption, figure=figure, plate=plate
    )


def _snapshots(evidence: PaperEvidence, team: Team, fly_again: bool) -> Iterator[ReportDrawing]:
    """The first seed on which the team formed with consensus, else the first; without consensus below it."""
    others = evidence.trials(team, evidence.stand_in, evidence.reference)
    found = evidence.trials(team, evidence.stand_in).items()
    pairs = sorted(((trial, others[key]) for key, trial in found if key in others), key=lambda pair: not pair[0].formed)
    for pair in pairs[:1]:
        steps = LONGER_STEPS if team == TEAMS[1] else STEPS
        read = [(trial.cell.protocol, record_of(evidence.results, trial, fly_again)[0], steps) for trial in pair]
        rows = [(name, record, steps) for name, record, steps in read if record is not None]
        why = "the first on which it formed with consensus" if pair[0].formed else "with consensus it formed on no seed"
        words = (
            f"{evidence.protocol} above, {evidence.reference} below, from the same start (seed {pair[0].seed}: {why}). "
            "Discs have the colour of the plan; beside them stand its letter and the robot's influence."
        )
        if len(rows) == len(pair):
            name = f"{team.shape}-{team.n_robots}"
            yield _drawing(name, f"{team}, with and without consensus", words, sheet(rows))


def _influence(evidence: PaperEvidence, fly_again: bool) -> Iterator[ReportDrawing]:
    """Three robots in the rounds before they agree, with their influence."""
    trials = evidence.trials(TEAMS[0], evidence.stand_in).values()
    for trial in [trial for trial in trials if trial.formed][:1]:
        record, _ = record_of(evidence.results, trial, fly_again)
        if record is not None:
            agreed = next(row.round for row in record.metrics if row.round and row.plans_in_use == 1)
            last = min(max(5, agreed), record.rounds)
            steps = (0, last - 4, last - 3), (last - 2, last - 1, last)
            words = (
                f"Three robots under {evidence.protocol}, seed {trial.seed}: beside each its plan and its influence."
            )
            yield _drawing("influence", "How influence decides", words, sheet([("", record, one) for one in steps]))


def paper_failures(evidence: Sequence[PaperEvidence], fly_again: bool) -> Iterator[Failure]:
    """The paper's two failures, each from the first trial that shows it, with the answer that caused it."""
    for one in evidence[:1]:
        trials = [trial for trial in one.results.trials if trial.cell.protocol == one.protocol]
        for which, team, tell in (
            (one.faulty_plan, TEAMS[-1], _faulty_plan),
            (one.swinging, TEAMS[0], _full_speed),
        ):
            shown = sorted(filter(which, trials), key=lambda trial: trial.cell.team != team)
            read = ((trial, *record_of(one.results, trial, fly_again)) for trial in shown[:MOST_READ])
            told = (tell(trial, record, source) for trial, record, source in read if record is not None)
            yield from islice(filter(None, told), 1)


def _faulty_plan(trial: TrialRow, record: RunRecord, source: str) -> Failure | None:
    plan = next((plan for plan in record.plans if plan.plan_id == record.states[-1].plan_ids[0]), None)
    if plan is None or record.mission.ideal is None:
        return None
    error = ShapeTarget(record.mission.ideal).error(plan.points).mean
    calls = [call for call in record.llm if (call.robot, call.kind) == (plan.proposer, "plan") and call.parsed]
    text = (
        f"The plan of robot {plan.proposer} is {error:.2f} units from the ideal shape in the mean. All "
        f"{trial.cell.team.n_robots} robots took it, and form its shape."
    )
    reason = "a faulty plan spreads to the whole team (lines 652-664)"
    figure = _overlay(record, plan, record.mission.ideal)
    return _failure(trial, reason, source, Cause(text, calls=tuple(calls[-1:])), figure, "paper-faulty-plan")


def _overlay(record: RunRecord, plan: PlanInfo, ideal: Sequence[Sequence[float]]) -> Figure:
    """The plan on the ideal shape, turned and moved to fit best; beside it the team that followed it."""
    points, shape = np.array(plan.points)[:, :2], np.array(ideal)[:, :2]
    match, k = ShapeTarget(shape).error(points), min(FAILED_STEP, record.rounds)
    moved = (shape - shape.mean(axis=0))[list(match.assignment)] @ match.rotation + points.mean(axis=0)
    with house_style():
        figure = new_figure(PAGE, 3.6)
        both = figure.subplots(1, 2, sharex=True, sharey=True)
        titles = f"plan of robot {plan.proposer}", f"the team in round {k}"
        for axes, shown, title in zip(both, (points, record.positions[k, :, :2]), titles, strict=True):
            frame(axes)
            axes.set(aspect="equal", title=title, xlabel="x [units]")
            axes.plot(*np.stack([moved, points], axis=1).T, color=FAINT, lw=0.8, zorder=2)
            axes.scatter(*moved.T, fc="none", ec=INK, s=90, zorder=3, label="ideal shape")
            look = plan_looks(record)[plan.plan_id]
            axes.scatter(*shown.T, fc=look.fill, ec=INK, s=30, lw=0.5, zorder=3, label="places of the plan, robots")
        both[0].set_ylabel("y [units]")
        figure.legend(*both[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
        figure.suptitle(model_names([record]), fontsize=7.5)
        return figure


def _full_speed(trial: TrialRow, record: RunRecord, source: str) -> Failure | None:
    """The first step at full speed past a goal that was near, of a team that had agreed."""
    limit = float(record.mission.mission.get("max_step") or np.inf)
    agreed = (k for k in range(1, record.rounds - 2) if len(set(record.states[k].plan_ids)) == 1)
    for k, robot in ((k, robot) for k in agreed for robot in range(trial.cell.team.n_robots)):
        goal, before = record.states[k].goals[robot], record.positions[k - 1, robot]
        step = float(np.linalg.norm(record.positions[k, robot] - before))
        away = np.inf if goal is None else float(np.linalg.norm(np.array(goal) - before))
        if step < 0.99 * limit or away > 0.6 * limit:  # answers are rounded
            continue
        text = (
            f"In round {k} the goal of robot {robot} is {away:.2f} units away, and its model steps {step:.2f}: at full "
            "speed, past it. So it goes on, and the team never comes to rest."
        )
        calls = [call for call in record.llm if (call.robot, call.kind, call.round) == (robot, "step", k)]
        reason = "a model that steps at full speed swings about its goal (lines 666-744)"
        figure = sheet([(trial.cell.protocol, record, range(k - 1, k + 3))])
        return _failure(trial, reason, source, Cause(text, calls=tuple(calls)), figure, "paper-full-speed")
    return None


def _failure(trial: TrialRow, reason: str, source: str, cause: Cause, figure: Figure, file: str) -> Failure:
    return Failure(trial=trial, reason=reason, source=source, stories=(story(cause),), figure=figure, file=file)
