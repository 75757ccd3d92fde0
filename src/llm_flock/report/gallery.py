"""The worst trials, with snapshots and the conversations that explain what happened."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from llm_flock.errors import FlockError, InputError
from llm_flock.experiments.store import TRIALS, read_trial
from llm_flock.record.reader import RunRecord, read_record
from llm_flock.record.schema import ChatLine, LlmEntry
from llm_flock.report.diagnosis import Cause, find_causes
from llm_flock.report.results import OUTCOMES, Results, TrialRow
from llm_flock.runtime.api import RECORD_NAME, run
from llm_flock.runtime.config import RunConfig
from llm_flock.viz.figures import snapshots

MOST_FLOWN_AGAIN = 100
"""Largest team that is flown again for the gallery; more robots would take minutes."""

LONGEST = 6000
"""Letters of a message that are shown at most."""

SEVERITY = ("broke off", "no answers", "interrupted", "budget", "not formed", "formed")
REPEATED = ("stopped", "rounds", "model_calls", "procrustes_mean")
"""Figures that are the same when the same code flies the same trial again."""


class Story(NamedTuple):
    """Something that went wrong in a trial.

    Attributes:
        sentence: what happened.
        about: whose conversation follows, and when; empty without one.
        conversation: of the robot that caused it; the role "verdict" says what became of an answer.
    """

    sentence: str
    about: str
    conversation: tuple[ChatLine, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """One trial of the gallery.

    Attributes:
        trial: the trial.
        reason: why it is here.
        source: origin of snapshots and conversations, or why there are none.
        stories: what happened; none without a record.
        figure: its snapshots; None without a record.
    """

    trial: TrialRow
    reason: str
    source: str
    stories: tuple[Story, ...] = ()
    figure: Figure | None = field(default=None, repr=False)

    @property
    def name(self) -> str:
        """Name of its files."""
        return f"failure-{self.trial.id}"


def worst(results: Results, most: int) -> list[TrialRow]:
    """The worst trials: the worst of each protocol and outcome, then the second worst of each, and so on.

    A trial is worse if its outcome is worse, then if it ended farther from the shape. Trials that formed are included
    only where robots came too near.
    """
    groups: dict[tuple[int, str], list[TrialRow]] = {}
    for trial in results.trials:
        if not trial.formed or trial.too_near:
            groups.setdefault((SEVERITY.index(trial.outcome), trial.cell.protocol), []).append(trial)
    for group in groups.values():
        group.sort(key=_badness, reverse=True)
    found: list[TrialRow] = []
    while len(found) < most and any(groups.values()):
        for key in sorted(groups):
            if groups[key] and len(found) < most:
                found.append(groups[key].pop(0))
    return found


def _badness(trial: TrialRow) -> float:
    error = trial.error
    return float("inf") if error is None else error / (trial.figures["spacing"] or 1.0)


def gallery(results: Results, most: int, *, fly_again: bool = True) -> Iterator[Failure]:
    """The worst trials, one after the other.

    Args:
        results: all trials.
        most: largest number of trials.
        fly_again: whether trials of simulated models without a record are flown again to get one.
    """
    for trial in worst(results, most):
        yield _failure(results, trial, fly_again)


def _failure(results: Results, trial: TrialRow, fly_again: bool) -> Failure:
    reason = OUTCOMES[trial.outcome] if not trial.formed else "it formed, but two robots came too near"
    if trial.outcome == "broke off":
        reason = f"it broke off: {trial.figures['error'] or trial.figures['reason']}"
    with tempfile.TemporaryDirectory(prefix="llm-flock-") as folder:
        try:
            record, source = _record(results, trial, Path(folder) if fly_again else None)
        except (FlockError, OSError) as error:
            return Failure(trial=trial, reason=reason, source=f"There are no pictures: {error}.")
        if record is None:
            return Failure(trial=trial, reason=reason, source=source)
        causes = find_causes(record)
        rounds = {0, record.rounds, *(cause.round for cause in causes[:2] if cause.round is not None)}
        if len(rounds) <= 2:
            rounds.add(record.rounds // 2)
        figure = snapshots(record, sorted(k for k in rounds if k <= record.rounds))
        return Failure(trial=trial, reason=reason, source=source, stories=tuple(map(_story, causes)), figure=figure)


def _story(cause: Cause) -> Story:
    about = ""
    if cause.entries:
        last = cause.entries[-1]
        question = {"plan": "asked for a plan", "step": "asked for its next step"}.get(last.kind, last.kind)
        about = f"Robot {last.robot}, {question} in round {last.round}, {last.model}"
    return Story(cause.sentence, about, tuple(_conversation(cause.entries)))


def _record(results: Results, trial: TrialRow, folder: Path | None) -> tuple[RunRecord | None, str]:
    """The kept record, or one of the trial flown again in `folder`; and a sentence about where it is from."""
    kept = trial.figures["record"]
    if kept is not None and (results.folder / kept).exists():
        return read_record(results.folder / kept), f"From its record, {kept}."
    if not trial.figures["simulated"]:
        return None, "No record was kept (see --keep-records of llm-flock sweep), so there are no pictures."
    if folder is None or trial.cell.team.n_robots > MOST_FLOWN_AGAIN:
        return None, "No record was kept, and the trial was not flown again."
    config = RunConfig.model_validate(read_trial(results.folder / TRIALS / f"{trial.id}.json").config)
    config = config.model_copy(update={"trial": config.trial.model_copy(update={"out": str(folder)})})
    try:
        summary: Mapping[str, Any] = run(config=config).summary.to_dict()
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001 - it may be the error that ended the trial; the page says so
        if not (folder / RECORD_NAME).exists():
            raise FlockError(f"flown again, it broke off at once: {error}") from None
        summary = {}
    same = all(summary.get(name) == trial.figures[name] for name in REPEATED)
    odd = "" if same else " It came out differently this time: other code or another machine flew it."
    return read_record(folder / RECORD_NAME), f"No record was kept; flown again from its configuration.{odd}"


def _conversation(entries: Sequence[LlmEntry]) -> Iterator[ChatLine]:
    """The last call of a thread with all messages before it, the answer, and what became of it."""
    if not entries:
        return
    last = entries[-1]
    for message in last.messages:
        yield message.model_copy(update={"text": _short(message.text)})
    if last.text is not None:
        yield ChatLine(role="assistant", text=_short(last.text))
    if last.parsed is not None:
        yield ChatLine(role="verdict", text="The answer was taken.")
    else:
        yield ChatLine(
            role="verdict", text=f"The answer was not used: {last.rejected or last.error or 'no answer came'}"
        )


def _short(text: str) -> str:
    if len(text) <= LONGEST:
        return text
    half = LONGEST // 2
    return f"{text[:half]}\n[... {len(text) - 2 * half:,} letters left out ...]\n{text[-half:]}"
