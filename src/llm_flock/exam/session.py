"""One model's exam from start to end: its files, its questions, and the row that comes out."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from llm_flock.errors import InputError
from llm_flock.exam.ask import SCRIPT, Outcome
from llm_flock.exam.examinee import Examinee, Setup
from llm_flock.exam.leaderboard import build_row, recording_name, slug
from llm_flock.exam.questions import Question
from llm_flock.exam.recordings import Conversations, read_parts
from llm_flock.exam.results import ResultFile, Sitting
from llm_flock.exam.seen import seen_in_training
from llm_flock.exam.sit import asked_of, round_of, sit, sitting_of
from llm_flock.exam.splits import PUBLIC_SEED, chosen, private_split, public_split
from llm_flock.llm.own import OwnModel
from llm_flock.llm.port import Usage
from llm_flock.llm.replay import ReplayModel
from llm_flock.llm.sources import habits_of

MOST_REPEATS = 1000
"""Most times that each question is asked."""

_PART = re.compile(r"\.part-(\d+)\.jsonl$")


@dataclass(frozen=True, slots=True, kw_only=True)
class Paper:
    """Which questions are asked: `public`, or `private` with a seed; some sections, and at most this number of each."""

    split: str = "public"
    seed: int | None = None
    sections: str | None = None
    limit: int | None = None
    repeats: int = 1

    def questions(self) -> tuple[Question, ...]:
        """The questions.

        Raises:
            InputError: there is no such split or section, a private one has no seed of its own, or a number is not
                allowed.
        """
        if not 1 <= self.repeats <= MOST_REPEATS:
            raise InputError("repeats", self.repeats, f"from 1 to {MOST_REPEATS}")
        if self.limit is not None and self.limit < 1:
            raise InputError("limit", self.limit, "at least 1")
        if self.seed is not None and self.seed < 0:
            raise InputError("seed", self.seed, "at least 0")
        if self.split not in ("public", "private"):
            raise InputError("split", self.split, "public or private")
        if self.split == "public" and self.seed not in (None, PUBLIC_SEED):
            raise InputError("seed", self.seed, says="belongs to a private split: --split private")
        if self.split == "private" and self.seed is None:
            raise InputError("seed", None, "a seed of the private split, which you keep for yourself")
        whole = public_split() if self.split == "public" or self.seed is None else private_split(self.seed)
        return chosen(whole, self.sections, self.limit)

    def flags(self) -> str:
        """The flags of `llm-flock exam` for these questions, with a blank before each."""
        named = {"split": None if self.split == "public" else self.split, "seed": self.seed}
        named |= {"sections": self.sections, "limit": self.limit, "repeats": self.repeats if self.repeats > 1 else None}
        return "".join(f" --{name} {value}" for name, value in named.items() if value is not None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Finished:
    """What came out: all results, whether they are complete, the row, and the recording of all conversations."""

    sitting: Sitting
    outcomes: Sequence[Outcome]
    complete: bool
    row: dict[str, Any] | None
    recording: Path | None


async def hold_exam(
    setup: Setup,
    paper: Paper,
    folder: Path,
    *,
    own: OwnModel | None = None,
    today: date,
    on_start: Callable[[int, int], None] = lambda _, __: None,
    on_outcome: Callable[[Outcome], None] = lambda _: None,
) -> Finished:
    """Ask a model all questions that have no result yet in a folder, and put a row together.

    Args:
        setup: the model, and how it is asked. Budgets count what is in the folder already.
        paper: which questions.
        folder: for results and recordings; files of the same exam in it are continued.
        own: a model as an object, in place of the one that `setup` names.
        today: the date of the row.
        on_start: called with the number of questions, and of those that have a result.
        on_outcome: called after each result.

    Raises:
        InputError: the model cannot be asked, the folder holds another exam of this name, or one is under way there.
        RecordError: results or recordings in the folder are damaged, or do not belong together.
    """
    stem = slug(setup.model)
    async with Examinee(setup, own) as examinee:
        examinee.check()
        questions = asked_of(examinee, paper.questions())
        if not questions:
            raise InputError("sections", paper.sections, f"a section that {setup.model} can be asked")
        sitting = sitting_of(examinee, questions, split=paper.split, seed=paper.seed, repeats=paper.repeats)
        with ResultFile(folder / f"{stem}.jsonl", sitting) as results:
            results.check(questions, paper.repeats)
            known = len(results.done)
            records = examinee.kind != "geometry" and not examinee.simulated
            parts = _parts(folder, stem) if records else []
            recorded = read_parts(parts)
            _count_spent(examinee, results.outcomes, recorded)
            if records:
                _check_recorded(folder, questions, results, recorded)
            on_start(len(questions) * paper.repeats, known)
            record = None
            if records and known < len(questions) * paper.repeats:
                record = folder / f"{stem}.part-{_next_number(parts):03d}.jsonl"
                parts.append(record)
            complete = await sit(
                examinee, questions, results, repeats=paper.repeats, record=record, on_outcome=on_outcome
            )
            outcomes = list({(o.question, o.repeat): o for o in results.outcomes}.values())
            whole = folder / f"{stem}.cassette.jsonl"
            recording = whole if read_parts(parts).save(whole) else None
        row = None
        if complete:
            # The examples are made with event loops of their own, which this one's thread cannot have.
            seen = await asyncio.to_thread(seen_in_training, examinee.name, questions, examinee.prompts, examinee.frame)
            row = build_row(
                sitting,
                outcomes,
                answered_by=setup.model if recording is None else _answered_by(recording),
                day=today,
                command=f"llm-flock exam {setup.model}{paper.flags()}{_setup_flags(setup)}",
                weights=examinee.weights,
                seen=seen,
                recording=None if recording is None else recording_name(sitting),
            )
    return Finished(sitting=sitting, outcomes=outcomes, complete=complete, row=row, recording=recording)


def _parts(folder: Path, stem: str) -> list[Path]:
    """Recordings of earlier sessions, in their order."""
    return sorted(folder.glob(f"{stem}.part-*.jsonl"))


def _next_number(parts: Sequence[Path]) -> int:
    """Number of the next session's recording: no older one, of whatever number, is written over."""
    numbers = [int(found[1]) for part in parts if (found := _PART.search(part.name))]
    return max(numbers, default=0) + 1


def _answered_by(recording: Path) -> str:
    """The names by which the models of a recording called themselves."""
    with ReplayModel(recording) as recorded:
        return ", ".join(sorted(recorded.models - {SCRIPT}))


def _count_spent(examinee: Examinee, outcomes: Sequence[Outcome], recorded: Conversations) -> None:
    """Count what earlier sessions used towards the budget, questions that were cut off included."""
    meter = examinee.meter
    calls = sum(outcome.calls for outcome in outcomes)
    tokens_input = sum(outcome.tokens_input for outcome in outcomes)
    tokens_output = sum(outcome.tokens_output for outcome in outcomes)
    cost_usd = sum(outcome.cost_usd or 0.0 for outcome in outcomes)
    meter.calls += max(calls, recorded.calls)
    used = recorded.usage
    meter.usage += Usage(input=max(tokens_input, used.input), output=max(tokens_output, used.output))
    meter.known_cost_usd += max(cost_usd, recorded.cost_usd)


def _check_recorded(folder: Path, questions: Sequence[Question], results: ResultFile, recorded: Conversations) -> None:
    by_id = {question.id: question for question in questions}
    stand = [outcome for outcome in results.outcomes if outcome.cause is None]
    recorded.check(stand, [round_of(by_id[o.question], o.repeat) for o in stand], folder)


def _setup_flags(setup: Setup) -> str:
    """Flags for all that is not the default and changes questions or answers.

    Those of a trained model are spelled out: its recording, which is asked by another name, needs them.
    """
    words = {"prompts": "brief", "frame": "own"} if habits_of(setup.model).frame == "own" else {}
    names = words | {name: value for name, value in setup.asked().items() if name not in ("model", "seed")}
    return "".join(f" --{name.replace('_', '-')} {value}" for name, value in names.items())
