"""The leaderboard: a row for each finished log of Inspect, in a file of its own, and a page made from these files."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from statistics import fmean, median
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from llm_flock.errors import FlockError, InputError
from llm_flock.printable import one_line
from llm_flock.validation import checked
from llm_flock_lab._exam.ask import Outcome
from llm_flock_lab._exam.questions import SECTIONS
from llm_flock_lab._experiments.statistics import CONFIDENCE, RESAMPLES, bootstrap_interval, wilson
from llm_flock_lab._experiments.store import is_inside, read_json, write_whole

PAGE = "index.md"

MARK = "<!-- Written by `llm-flock exam"
"""Stands in every page that this module writes."""

# Six decimals, so that files do not differ by the last digit of a machine.
Number = Annotated[float, Field(ge=0, le=1e12, allow_inf_nan=False), AfterValidator(lambda number: round(number, 6))]


class Share(NamedTuple):
    """A share of questions with its 95 % interval; repeats of one question are averaged."""

    value: Number
    low: Number
    high: Number


class Figures(BaseModel):
    """Results of some questions: how many, the share right at first ask, the median error of first answers."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    questions: int
    first: Share
    error: Number | None


class Row(BaseModel):
    """The scores of one model: a file of the leaderboard. Teachers of a model measure `taught` and enter it by hand."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    model: str
    answered_by: str
    simulated: bool
    date: str
    command: str
    version: int
    split: str  # with the seed of a private one
    questions: str  # their digest, like `prompts`
    prompts: str
    count: int
    repeats: int
    versions: Mapping[str, str]  # of packages, and digests of a model's files
    total: Share  # mean of the sections' shares right at first ask; `total_two`: after two reasons
    total_two: Share
    sections: Mapping[str, Figures]
    bands: Any = Field(default=None, exclude=True)  # older rows have the sections by size, too
    calls: int
    tokens: int
    seconds: Number  # for a question, median
    cost_usd: Number | None
    taught: Mapping[str, Number] | None = None  # share of a section whose prompts the model was taught

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
    # Older logs have more fields.
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
        **summary(outcomes),
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


def summary(outcomes: Iterable[Outcome]) -> dict[str, Any]:
    """The fields of a `Row` that follow from the results, at least one, in any order."""
    ordered = sorted(outcomes, key=lambda o: (o.question, o.repeat))
    sections = {s: [o for o in ordered if o.section == s] for s in SECTIONS}
    sections = {name: found for name, found in sections.items() if found}
    costs = [o.cost_usd for o in ordered]
    return {
        "total": _total(sections.values(), 0),
        "total_two": _total(sections.values(), 2),
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


def _total(sections: Iterable[Sequence[Outcome]], reasons: int) -> Share:
    """The mean over sections, with an interval by drawing questions again within each section."""
    rng = np.random.default_rng(0)
    draws = np.zeros(RESAMPLES)
    values: list[float] = []
    for outcomes in sections:
        rates = np.array(_rates(_questions(outcomes), reasons))
        values.append(float(rates.mean()))
        shares = rng.multinomial(len(rates), np.full(len(rates), 1 / len(rates)), size=RESAMPLES) / len(rates)
        draws = draws + shares @ rates
    ends = np.quantile(draws / len(values), [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Share(value=fmean(values), low=float(ends[0]), high=float(ends[1]))


def publish(folder: Path, rows: Sequence[Row]) -> list[Path]:
    """Write rows into the folder, and the page of all rows there; returns what was written."""
    page = folder / PAGE
    if not rows and not folder.is_dir():
        raise InputError("page", str(folder), "a folder that is there, with the rows of a leaderboard")
    if page.exists() and not (is_inside(page, folder) and MARK in page.read_text(encoding="utf-8", errors="replace")):
        raise InputError("page", str(folder), says=f"its {PAGE} was not written by this command, and is left alone")
    known = {row.file_name: row for row in read_rows(folder)}
    new: dict[str, Row] = {}
    for row in rows:
        old = known.get(row.file_name)
        if old is not None and (old.model, old.split) != (row.model, row.split):
            raise InputError("page", str(folder), says=f"{row.file_name} is the row of {old.model}")
        if old is not None and old.count > row.count:
            says = f"{row.file_name} is a row of {old.count} questions; one of {row.count} goes into another folder"
            raise InputError("page", str(folder), says=says)
        if old is not None and (old.questions, old.prompts) == (row.questions, row.prompts):
            row = row.model_copy(update={"taught": old.taught})
        new[row.file_name] = row
    for name, row in new.items():
        write_whole(folder / name, (row.model_dump_json(indent=1) + "\n").encode())
    write_whole(page, page_text((known | new).values()).encode())
    return [*(folder / name for name in new), page]


def read_rows(folder: Path) -> list[Row]:
    rows: list[Row] = []
    for path in sorted(folder.glob("*.json")):
        try:
            rows.append(checked(Row, read_json(path, dict[str, Any], "a table")))
        except FlockError as error:
            raise InputError("page", str(path), f"a row of the leaderboard ({error})") from None
    return rows


HEAD = f"""\
# Which model can fly?

{MARK} --page docs/leaderboard`; edit the rows' files or the program, not this page. -->

Results of [the exam](../how-to/exam.md): questions of the kinds that robots ask their models, with the prompts, parsers
and checks of a run, scored by code. A share is of the questions that were right at first ask; in brackets, a 95 %
interval by drawing questions again. The total is the mean of the sections that were asked. Rows with fewer questions
have wider intervals, and say how many they had. Tokens are a call's, in and out; seconds are the median of a question.
Each row was reduced from a log of Inspect, and stands with the command that made it in a file beside this page. A
command with `replay:` scores answers that the model gave before, from the recording beside this page.

## Models
"""

STAND_INS = """\
## Stand-ins

These are no language models. *simulated* rows are programs that read the prompts and make the faults that
[their names say](../reference/simulated.md); geometry plans without any prompt, and knows no points for a shape in
words. They show what the exam measures: that every section can be answered from its prompts alone
(`simulated:careful`), that chance answers hardly any (`simulated:random`), and what each fault costs. They are not
asked for missions in plain words, which they cannot read. All but `simulated:careful` walk straight and leave others to
the shield, so that robots in the way (`others`) are beyond them. The command of a row gives it again, digit for digit
but the seconds.
"""

Column = tuple[str, Callable[[Row], str]]


def page_text(rows: Iterable[Row]) -> str:
    ordered = sorted(rows, key=lambda row: (-row.total.value, row.model))
    models = [row for row in ordered if not row.stand_in]
    stand_ins = [row for row in ordered if row.stand_in]
    parts = [HEAD, _table(models, SCORES) if models else "No model has sat the exam yet.\n"]
    if models:
        parts += ["### How they were asked\n", _table(models, [*ASKED, ("Taught", _taught)])]
        parts += ["*Taught*: share of the questions whose prompt was in the training set of the documented recipe.\n"]
    parts += [STAND_INS, _table(stand_ins, SCORES), "### How they were asked, stand-ins\n", _table(stand_ins, ASKED)]
    return "\n".join(parts)


def _table(rows: Sequence[Row], columns: Sequence[Column]) -> str:
    return _lines([[name for name, _ in columns], *([cell(row) for _, cell in columns] for row in rows)])


def _lines(rows: Sequence[Sequence[str]]) -> str:
    """A table of Markdown; the first row is its head."""
    # Names come from providers: none of them may end a cell or a row.
    lines = [f"| {' | '.join(one_line(cell).replace('|', '&#124;') for cell in row)} |" for row in rows]
    return "\n".join([lines[0], f"| {' | '.join(['---'] * len(rows[0]))} |", *lines[1:]]) + "\n"


def _section_cell(section: str) -> Callable[[Row], str]:
    return lambda row: _percent(row.sections[section].first.value) if section in row.sections else "-"


def _taught(row: Row) -> str:
    if row.taught is None:
        return "-"
    return ", ".join(f"{name} {_percent(share)}" for name, share in row.taught.items() if share) or "none"


def _percent(value: float) -> str:
    return f"{100 * value:.0f} %"


def _interval(share: Share) -> str:
    return f"{_percent(share.value)} [{100 * share.low:.0f}, {100 * share.high:.0f}]"


SCORES: Sequence[Column] = (
    ("Model", lambda row: f"`{row.model}`" + (" *simulated*" if row.simulated else "")),
    ("Total", lambda row: _interval(row.total)),
    ("After two reasons", lambda row: _percent(row.total_two.value)),
    *((section, _section_cell(section)) for section in SECTIONS),
    ("Questions", lambda row: str(row.count)),
    ("Tokens a call", lambda row: f"{row.tokens / max(1, row.calls):.0f}"),
    ("Seconds", lambda row: f"{row.seconds:.2f}"),
    ("US dollars", lambda row: "not known" if row.cost_usd is None else f"{row.cost_usd:.2f}"),
)
"""Columns of the results."""

ASKED: Sequence[Column] = (
    ("Model", lambda row: f"`{row.model}`"),
    ("Answered by", lambda row: f"`{row.answered_by}`"),
    ("Split", lambda row: f"v{row.version} {row.split}"),
    ("Date", lambda row: row.date),
    ("LLM-Flock", lambda row: row.versions.get("llm-flock", "-")),
    ("Command", lambda row: f"`{row.command}`"),
)
"""Columns of how models were asked."""
