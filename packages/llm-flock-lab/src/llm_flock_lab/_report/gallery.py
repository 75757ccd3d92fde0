"""The worst trials, with snapshots and the conversations that explain what happened."""

from __future__ import annotations

import tempfile
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from llm_flock.arrays import flattened
from llm_flock.errors import FlockError, InputError
from llm_flock.metrics import ROUNDING, segment_separation
from llm_flock.record import ENDINGS, Cause, ChatLine, RunRecord, read_record
from llm_flock.runtime import RECORD_NAME, RunConfig, run
from llm_flock_lab._experiments.store import TRIALS, is_inside, read_trial
from llm_flock_lab._report.results import Results, TrialRow
from llm_flock_view._figures.figures import snapshots

LONGEST = 6000  # letters of a message that are shown at most

SEVERITY = ("broke off", "no answers", "no plan", "interrupted", "budget", "not formed", "formed")
"""Outcomes, the worst first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Story:
    """Something that went wrong in a trial, and the call behind it, with what became of its answer as "verdict"."""

    text: str
    about: str = ""
    conversation: tuple[ChatLine, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """One trial of the gallery: why it is there, and what happened; `source` names its record, or why there is none."""

    trial: TrialRow
    reason: str
    source: str
    stories: tuple[Story, ...] = ()
    figure: Figure | None = field(default=None, repr=False)
    file: str = ""

    @property
    def name(self) -> str:
        """Name of its figure's files."""
        return self.file or f"failure-{self.trial.id}"


def worst(results: Results, most: int) -> list[TrialRow]:
    """The worst trials by outcome, then by error: first of each protocol and outcome, then the second of each, ..."""
    groups: defaultdict[tuple[int, str], list[TrialRow]] = defaultdict(list)
    for trial in sorted(results.trials, key=_badness, reverse=True):
        if not trial.formed or trial.too_near:
            groups[SEVERITY.index(trial.outcome), trial.cell.protocol].append(trial)
    places = sorted((place, key) for key, group in groups.items() for place in range(len(group)))
    return [groups[key][place] for place, key in places[:most]]


def _badness(trial: TrialRow) -> float:
    error = trial.error
    return float("inf") if error is None else error / (trial.figures["spacing"] or 1.0)


def gallery(results: Results, most: int, *, fly_again: bool = True) -> Iterator[Failure]:
    """The `most` worst trials; those of simulated models without a record can be flown again to get one."""
    for trial in worst(results, most):
        yield _failure(results, trial, fly_again)


def _failure(results: Results, trial: TrialRow, fly_again: bool) -> Failure:
    reason = ENDINGS[trial.outcome] if not trial.formed else "it formed, but two robots came too near"
    if trial.outcome == "broke off":
        reason = f"it broke off: {trial.figures['error'] or trial.figures['reason']}"
    record, source = record_of(results, trial, fly_again)
    if record is None:
        return Failure(trial=trial, reason=reason, source=source)
    causes = find_causes(record)
    rounds = {0, record.rounds, *(cause.round for cause in causes[:2] if cause.round is not None)}
    stories = tuple(map(story, causes))
    if len(rounds) <= 2:
        rounds.add(record.rounds // 2)
    figure = snapshots(record, sorted(k for k in rounds if k <= record.rounds))
    return Failure(trial=trial, reason=reason, source=source, stories=stories, figure=figure)


def record_of(results: Results, trial: TrialRow, fly_again: bool) -> tuple[RunRecord | None, str]:
    """The record of a trial, kept or flown again, or None; and a sentence about where it is from, or why it is not."""
    with tempfile.TemporaryDirectory(prefix="llm-flock-") as folder:
        try:
            return _record(results, trial, Path(folder) if fly_again else None)
        except (FlockError, OSError) as error:
            return None, f"There are no pictures: {error}."


def find_causes(record: RunRecord) -> list[Cause]:
    """The causes of a failure in a record: robots that came too near, then the reason why it did not form."""
    crash = _crash(record)
    return [*([] if crash is None else [crash]), *record.diagnosis().causes]


def _crash(record: RunRecord) -> Cause | None:
    """The first round in which two robots came nearer than the safe distance while they moved."""
    mission = record.mission.mission
    safe, places = float(mission["safe_distance"]) - ROUNDING, flattened(record.positions, mission.get("downwash", 1.0))
    for number, after in enumerate(places):
        before = places[max(0, number - 1)]
        if segment_separation(before, after) >= safe:
            continue
        gaps = {
            pair: segment_separation(before[[*pair]], after[[*pair]]) for pair in combinations(range(len(after)), 2)
        }
        first, second = pair = min(gaps, key=lambda pair: gaps[pair])
        what = f"robots {first} and {second} came within {gaps[pair]:.2f} units of each other"
        if number == 0:
            return Cause(f"At the start, {what}.", pair, 0)
        moved = np.linalg.norm(after - before, axis=1)
        origins = record.states[number].origins
        robot = min(pair, key=lambda k: (origins[k] != "model", -float(moved[k])))
        text = f"In round {number}, {what}; robot {robot} moved {moved[robot]:.2f} units."
        steps = [
            entry for entry in record.llm if (entry.robot, entry.kind) == (robot, "step") and entry.round <= number
        ]
        return Cause(text, pair, number, tuple(entry for entry in steps if entry.round == steps[-1].round))
    return None


def story(cause: Cause) -> Story:
    """What happened, and the last call behind it."""
    if not cause.calls:
        return Story(text=cause.text)
    last = cause.calls[-1]
    question = {"plan": "asked for a plan", "step": "asked for its next step"}.get(last.kind, last.kind)
    lines = [message.model_copy(update={"text": _short(message.text)}) for message in last.messages]
    if last.text is not None:
        lines.append(ChatLine(role="assistant", text=_short(last.text)))
    refused = f"The answer was not used: {last.rejected or last.error or 'no answer came'}"
    lines.append(ChatLine(role="verdict", text=refused if last.parsed is None else "The answer was taken."))
    about = f"Robot {last.robot}, {question} in round {last.round}, {last.model}"
    return Story(text=cause.text, about=about, conversation=tuple(lines))


def _short(text: str) -> str:
    half = LONGEST // 2
    if len(text) <= LONGEST:
        return text
    return f"{text[:half]}\n[... {len(text) - 2 * half:,} letters left out ...]\n{text[-half:]}"


def _record(results: Results, trial: TrialRow, folder: Path | None) -> tuple[RunRecord | None, str]:
    """The kept record, or one of the trial flown again in `folder`; and a sentence about where it is from."""
    kept = trial.figures["record"]
    if kept is not None and is_inside(record := results.folder / kept, results.folder):
        return read_record(record), f"From its record, {kept}."
    if not trial.figures["simulated"]:
        return None, "No record was kept (see --keep-records of llm-flock sweep), so there are no pictures."
    if folder is None or trial.cell.team.n_robots > 100:  # more robots would take minutes
        return None, "No record was kept, and the trial was not flown again."
    config, outside = RunConfig.stored(read_trial(results.folder / TRIALS / f"{trial.id}.json").config)
    if outside:
        why = f"its configuration names files, code or addresses ({', '.join(outside)})"
        return None, f"No record was kept, and the trial was not flown again: {why}."
    config = config.model_copy(update={"trial": config.trial.model_copy(update={"out": str(folder)})})
    try:
        summary: Mapping[str, Any] = run(config=config, progress=False, trace=False).summary.to_dict()
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001 - it may be the error that ended the trial; the page says so
        if not (folder / RECORD_NAME).exists():
            raise FlockError(f"flown again, it broke off at once: {error}") from None
        summary = {}
    repeated = ("stopped", "rounds", "model_calls", "procrustes_mean")
    same = all(summary.get(name) == trial.figures[name] for name in repeated)
    odd = "" if same else " It came out differently this time: other code or another machine flew it."
    return read_record(folder / RECORD_NAME), f"No record was kept; flown again from its configuration.{odd}"
