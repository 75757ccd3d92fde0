"""The rows of the leaderboard: the scores of one model, from a finished log of Inspect, each in a file of its own."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from statistics import fmean, median
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from llm_flock.errors import FlockError, InputError
from llm_flock.validation import checked
from llm_flock_lab._exam.ask import Outcome
from llm_flock_lab._exam.questions import SECTIONS, WRITTEN
from llm_flock_lab._experiments.statistics import bootstrap_interval, wilson
from llm_flock_lab._experiments.store import read_json

# Six decimals, so that files do not differ by the last digit of a machine.
Number = Annotated[float, Field(ge=0, le=1e12, allow_inf_nan=False), AfterValidator(lambda number: round(number, 6))]
Count = Annotated[int, Field(ge=0, le=10**12)]
Name = Annotated[str, Field(pattern=r"^[\w.+:!~ -]*$")]  # stands on the page as it is


class Share(NamedTuple):
    """A share of questions with its 95 % interval; repeats of one question are averaged."""

    value: Number
    low: Number
    high: Number


class Figures(BaseModel):
    """Results of some questions: how many, the share right at first ask, the median error of first answers."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    questions: Count
    first: Share
    error: Number | None


class Row(BaseModel):
    """The scores of one model: a file of the leaderboard. Teachers of a model measure `taught` and enter it by hand."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    model: str
    answered_by: str
    simulated: bool
    date: Name
    command: str
    version: Count
    split: Name  # with the seed of a private one
    questions: str  # their digest, like `prompts`
    prompts: str
    count: Count
    repeats: Count
    versions: Mapping[str, Name]  # of packages, and digests of a model's files
    total: Share | None  # mean over all sections, right at first ask; None if one was not asked
    total_two: Share | None  # the same after two reasons
    sections: Mapping[str, Figures]
    calls: Count
    tokens: Count
    seconds: Number  # for a question, median
    cost_usd: Number | None
    taught: Mapping[Name, Number] | None = None  # share of a section whose prompts the model was taught

    @property
    def stand_in(self) -> bool:
        return self.simulated or self.model == "geometry"

    @property
    def file_name(self) -> str:
        # The model may be a path: its end counts.
        name = self.model if self.split == "public" else f"{self.model} {self.split}"
        return re.sub(r"[^A-Za-z0-9.]+", "-", name)[-100:].strip("-") + ".json"


def read_log(path: Path | str) -> Row:
    """The row of a finished log of the exam's task."""
    log = import_module("inspect_ai.log").read_eval_log(str(path))
    samples: list[Any] = log.samples or []
    if log.status != "success" or not samples or any(sample.error is not None for sample in samples):
        raise InputError("log", str(path), "a log whose questions all have an answer: go on with the same command")
    outcomes = [msgspec.convert(sample.scores["by_our_checks"].metadata, Outcome) for sample in samples]
    own = log.eval.model.startswith("flock/")
    model: str = log.eval.model.removeprefix("flock/")
    answered_by = ", ".join(sorted({o.answered_by for o in outcomes if o.answered_by is not None})) or model
    given: dict[str, Any] = {"split": "public", **log.eval.task_args_passed}
    repeats: int = log.eval.config.epochs or 1
    return Row(
        model=answered_by if own and model.startswith("replay:") else model,
        answered_by=answered_by,
        simulated=log.eval.metadata["simulated"],
        date=log.eval.created[:10],
        command=_command(log.eval, repeats),
        version=log.eval.task_version,
        split=given["split"] + (f" {given['seed']}" if given["split"] == "private" else ""),
        questions=log.eval.metadata["questions"],
        prompts=log.eval.metadata["prompts"],
        count=len({o.question for o in outcomes}),
        repeats=repeats,
        versions={**log.eval.metadata["versions"], **log.eval.packages},
        **summary(outcomes, given["split"]),
    )


def _command(spec: Any, repeats: int) -> str:
    given: dict[str, Any] = dict(spec.task_args_passed)
    settings = spec.model_generate_config
    if not spec.model.startswith("flock/"):
        return f"inspect eval llm_flock/exam --model {spec.model}" + "".join(f" -T {k}={v}" for k, v in given.items())
    given |= {"repeats": repeats if repeats > 1 else None, "temperature": settings.temperature}
    given |= {"model_seed": settings.seed, "reasoning_effort": settings.reasoning_effort}
    given |= {"max_answer_tokens": settings.max_tokens}
    flags = "".join(f" --{name.replace('_', '-')} {value}" for name, value in given.items() if value is not None)
    return f"llm-flock exam {spec.model.removeprefix('flock/')}{flags}"


def summary(outcomes: Iterable[Outcome], split: str = "public") -> dict[str, Any]:
    """The fields of a `Row` that follow from the results, at least one, in any order."""
    ordered = sorted(outcomes, key=lambda o: (o.question, o.repeat))
    sections = {s: [o for o in ordered if o.section == s] for s in SECTIONS}
    sections = {name: found for name, found in sections.items() if found}
    whole = {*SECTIONS} - (set() if split == "public" else WRITTEN) == {*sections}
    costs = [o.cost_usd for o in ordered]
    return {
        "total": _total(sections, 0) if whole else None,
        "total_two": _total(sections, 2) if whole else None,
        "sections": {name: _figures(found) for name, found in sections.items()},
        "calls": sum(o.calls for o in ordered),
        "tokens": sum(o.tokens_input + o.tokens_output for o in ordered),
        "seconds": median(o.seconds for o in ordered),
        "cost_usd": None if None in costs else sum(cost for cost in costs if cost is not None),
    }


def _figures(outcomes: Sequence[Outcome]) -> Figures:
    questions = _questions(outcomes)
    errors = [o.error for o in outcomes if o.error is not None]
    error = median(errors) if errors else None
    return Figures(questions=len(questions), first=_share(_rates(questions, 0)), error=error)


def _questions(outcomes: Iterable[Outcome]) -> list[list[Outcome]]:
    found: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        found.setdefault(outcome.question, []).append(outcome)
    return list(found.values())


def _rates(questions: Sequence[Sequence[Outcome]], reasons: int) -> list[float]:
    """Share of each question's repeats that were right after this number of reasons or fewer."""
    return [fmean(o.tries is not None and o.tries <= reasons for o in found) for found in questions]


def _share(rates: Sequence[float]) -> Share:
    """The mean over questions with its bootstrap interval; with Wilson's where all are equal, as that has a width."""
    alike = set(rates) in ({0.0}, {1.0})
    found = wilson(int(sum(rates)), len(rates)) if alike else bootstrap_interval(rates)
    # A single question that was right in some repeats says nothing about others.
    low, high = 0.0 if found.low is None else found.low, 1.0 if found.high is None else found.high
    return Share(value=found.value, low=low, high=high)


def _total(sections: Mapping[str, Sequence[Outcome]], reasons: int) -> Share:
    """The mean over sections, with an interval from theirs (MOVER; Zou and Donner 2008): it has a width if one has."""
    shares = np.array([_share(_rates(_questions(found), reasons)) for found in sections.values()])
    value, low, high = shares.T
    below, above = np.linalg.norm(value - low) / len(shares), np.linalg.norm(high - value) / len(shares)
    mean = float(value.mean())
    return Share(value=mean, low=max(0.0, mean - float(below)), high=min(1.0, mean + float(above)))


def read_rows(folder: Path) -> list[Row]:
    rows: list[Row] = []
    for path in sorted(folder.glob("*.json")):
        try:
            rows.append(checked(Row, read_json(path, dict[str, Any], "a table")))
        except FlockError as error:
            raise InputError("page", str(path), f"a row of the leaderboard ({error})") from None
    return rows
