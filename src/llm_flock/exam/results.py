"""The file of results: a header that says what was asked of whom, then one line for each question, as it is answered.

A line is written as soon as its question is over, so an exam that broke off goes on where it stopped.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec

from llm_flock.errors import InputError, RecordError
from llm_flock.exam.ask import Outcome
from llm_flock.exam.figures import SIZES
from llm_flock.exam.questions import Question
from llm_flock.file_lock import lock_file

HEADER = "llm_flock_exam"
COUNTS = (
    *("n", "distance", "repeat", "tries", "error", "degrees"),
    *("calls", "tokens_input", "tokens_output", "seconds", "cost_usd"),
)
"""Fields of a result that are never below 0."""

LARGEST = 1e12
"""Largest of these counts and figures that is believed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sitting:
    """What is asked of whom.

    Attributes:
        version: of the exam.
        split: `public` or `private`.
        seed: of a private split, None for the public one.
        questions: digest of the questions that are asked, in their order.
        prompts: digest of their prompts.
        count: number of these questions.
        repeats: how often each is asked.
        setup: model and settings.
        simulated: whether a stand-in answers.
    """

    version: int
    split: str
    seed: int | None
    questions: str
    prompts: str
    count: int
    repeats: int
    setup: Mapping[str, Any]
    simulated: bool


class ResultFile:
    """A result file that is being written; a context manager. It is locked: two exams do not write one file.

    Attributes:
        outcomes: those that are known, in the order of the file.

    Raises:
        InputError: for field `out`: the file holds results of other questions, or of another model or setting, or
            another exam writes it.
        RecordError: it is no result file, or damaged; it is as it was.
    """

    def __init__(self, path: Path, sitting: Sitting) -> None:
        self.outcomes: list[Outcome] = []
        self._path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("a", encoding="utf-8", newline="\n")
        except OSError as error:
            raise InputError("out", str(path), f"a file that can be written ({error.strerror})") from None
        try:
            if not lock_file(self._file.fileno()):
                raise InputError("out", str(path), says="another exam writes this file now: wait for it to end")
            self._continue(sitting)
        except BaseException:
            self._file.close()
            raise

    def _continue(self, sitting: Sitting) -> None:
        """Read what is there, cut off what was written of a line when the program was killed, or write the header."""
        content = self._path.read_bytes()
        whole = content.rfind(b"\n") + 1
        begins = json.dumps({HEADER: sitting.version}).encode()[:-1].replace(b" ", b"")
        if whole or not (content.startswith(begins) or begins.startswith(content)):
            found, self.outcomes = read_results(self._path)
            other = next((name for name, value in asdict(sitting).items() if asdict(found)[name] != value), None)
            if other is not None:
                was, now = getattr(found, other), getattr(sitting, other)
                allowed = f"a new file, or one of the same exam: its {other} was {was!r}, and now it is {now!r}"
                raise InputError("out", str(self._path), allowed)
        if whole < len(content):
            self._file.truncate(whole)
        if not whole:
            self._write({HEADER: sitting.version, **asdict(sitting)})

    @property
    def done(self) -> set[tuple[str, int]]:
        """Question and repeat of every result that stands; those without an answer are asked again."""
        return {(outcome.question, outcome.repeat) for outcome in self.outcomes if outcome.cause is None}

    def check(self, questions: Iterable[Question], repeats: int) -> None:
        """Check that every result is one of these questions.

        Raises:
            RecordError: one is not.
        """
        sections = {question.id: question.section for question in questions}
        for outcome in self.outcomes:
            if sections.get(outcome.question) != outcome.section or outcome.repeat >= repeats:
                what = f"{outcome.question} of section {outcome.section}, repeat {outcome.repeat}"
                raise RecordError(f"{self._path}: damaged (this exam has no {what})")

    def add(self, outcome: Outcome) -> None:
        """Write a result; a later one of the same question replaces an earlier one."""
        self.outcomes.append(outcome)
        self._write(asdict(outcome))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def _write(self, line: dict[str, Any]) -> None:
        self._file.write(json.dumps(line, separators=(",", ":"), allow_nan=False) + "\n")
        self._file.flush()


def read_results(path: Path) -> tuple[Sitting, list[Outcome]]:
    """Header and results of a file, the last result of each question; a line that was cut off in writing is left out.

    Raises:
        InputError: for field `results`: the file cannot be read.
        RecordError: it is no result file, or a line is damaged.
    """
    try:
        lines = path.read_bytes().split(b"\n")[:-1]
    except OSError as error:
        raise InputError("results", str(path), f"a file that can be read ({error.strerror})") from None
    try:
        header = msgspec.json.decode(lines[0], type=dict[str, Any])
        del header[HEADER]
        sitting = msgspec.convert(header, Sitting)
    except (LookupError, msgspec.MsgspecError, RecursionError, UnicodeDecodeError):
        raise RecordError(
            f"{path}: not a result file of `llm-flock exam`: its first line must hold {HEADER!r}"
        ) from None
    found: dict[tuple[str, int], Outcome] = {}
    for number, line in enumerate(lines[1:], start=2):
        try:
            outcome = msgspec.json.decode(line, type=Outcome)
        except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
            raise RecordError(f"{path}, line {number}: damaged ({error})") from None
        counts = {name: getattr(outcome, name) for name in COUNTS}
        limits = {**dict.fromkeys(COUNTS, LARGEST), "n": SIZES[-1][1]}
        wrong = next((name for name, value in counts.items() if not 0 <= (value or 0) <= limits[name]), None)
        if wrong is not None:
            says = f"{wrong} = {counts[wrong]!r:.40}: expected at least 0, and at most {limits[wrong]:g}"
            raise RecordError(f"{path}, line {number}: damaged ({says})")
        found[outcome.question, outcome.repeat] = outcome
    return sitting, list(found.values())
