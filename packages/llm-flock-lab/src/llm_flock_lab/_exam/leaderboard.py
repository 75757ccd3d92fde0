"""The page of the leaderboard, made from the files of its rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from llm_flock.errors import InputError
from llm_flock.printable import one_line
from llm_flock_lab._exam.questions import SECTIONS
from llm_flock_lab._exam.rows import Row, Share, read_rows
from llm_flock_lab._experiments.store import is_inside, write_whole

PAGE = "index.md"

MARK = "<!-- Written by `llm-flock exam"  # stands in every page that this module writes


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


HEAD = f"""\
# Which model can fly?

{MARK} --page docs/leaderboard`; edit the rows' files or the program, not this page. -->

Results of [the exam](../how-to/exam.md): questions of the kinds that robots ask their models, with the prompts, parsers
and checks of a run, scored by code. A share is of the questions that were right at first ask; in brackets, a 95 %
interval by drawing questions again. The total is the mean over all sections, and a row that lacks one has none. Its
interval is made from those of the sections. Rows with fewer questions have wider ones, and say how many they had.
Tokens are a call's, in and out; seconds are the median of a question. Each row was reduced from a log of Inspect, and
stands with the command that made it in a file beside this page. A command with `replay:` scores answers that the model
gave before, from the recording beside this page.

## Models
"""

STAND_INS = """\
## Stand-ins

These are no language models. *simulated* rows are programs that read the prompts and make the faults that
[their names say](../reference/simulated.md); geometry plans without any prompt, and takes the first option of a
judgement. They show what the exam measures: that what is not in words can be answered from the prompts alone
(`simulated:careful`), that chance answers hardly any (`simulated:random`), and what each fault costs. They read no
words: no missions, no edits, no shapes (`distraction`) and no wishes (half of `judgement`). All but
`simulated:careful` walk straight, so that robots in the way (`others`, `agreement`) are beyond them.
`benchmarks.twenty_lines:Short` is a program of twenty lines: its own number, the straight way, always a circle, the
first shape that a mission names, the first option. The command of a row gives it again, digit for digit but the
seconds.
"""

Column = tuple[str, Callable[[Row], str]]


def page_text(rows: Iterable[Row]) -> str:
    ordered = sorted(rows, key=lambda row: (row.total is None, 0 if row.total is None else -row.total.value, row.model))
    models = [row for row in ordered if not row.stand_in]
    stand_ins = [row for row in ordered if row.stand_in]
    parts = [HEAD, _table(models, SCORES) if models else "No model has sat the exam yet.\n"]
    if models:
        parts += ["### How they were asked\n", _table(models, [*ASKED, ("Taught", _taught)])]
        parts += ["*Taught*: share of the questions whose prompt was in the training set of the documented recipe.\n"]
    parts += [STAND_INS, _table(stand_ins, SCORES), "### How they were asked, stand-ins\n", _table(stand_ins, ASKED)]
    return "\n".join(parts)


def _table(rows: Sequence[Row], columns: Sequence[Column]) -> str:
    """A table of Markdown."""
    lines = [[name for name, _ in columns], ["---"] * len(columns), *([cell(r) for _, cell in columns] for r in rows)]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def _code(text: str) -> str:
    """Text of others as code on the page, which nothing in it may end, nor its cell or row."""
    return "`" + one_line(text).replace("|", "&#124;").replace("`", "'") + "`"


def _section_cell(section: str) -> Callable[[Row], str]:
    return lambda row: _percent(row.sections[section].first.value) if section in row.sections else "-"


def _taught(row: Row) -> str:
    if row.taught is None:
        return "-"
    return ", ".join(f"{name} {_percent(share)}" for name, share in row.taught.items() if share) or "none"


def _percent(value: float) -> str:
    return f"{100 * value:.0f} %"


def _interval(share: Share | None) -> str:
    return "-" if share is None else f"{_percent(share.value)} [{100 * share.low:.0f}, {100 * share.high:.0f}]"


SCORES: Sequence[Column] = (
    ("Model", lambda row: _code(row.model) + (" *simulated*" if row.simulated else "")),
    ("Total", lambda row: _interval(row.total)),
    ("After two reasons", lambda row: "-" if row.total_two is None else _percent(row.total_two.value)),
    *((section, _section_cell(section)) for section in SECTIONS),
    ("Questions", lambda row: str(row.count)),
    ("Tokens a call", lambda row: f"{row.tokens / max(1, row.calls):.0f}"),
    ("Seconds", lambda row: f"{row.seconds:.2f}"),
    ("US dollars", lambda row: "not known" if row.cost_usd is None else f"{row.cost_usd:.2f}"),
)
"""Columns of the results."""

ASKED: Sequence[Column] = (
    ("Model", lambda row: _code(row.model)),
    ("Answered by", lambda row: _code(row.answered_by)),
    ("Split", lambda row: f"v{row.version} {row.split}"),
    ("Date", lambda row: row.date),
    ("LLM-Flock", lambda row: row.versions.get("llm-flock", "-")),
    ("Command", lambda row: _code(row.command)),
)
"""Columns of how models were asked."""
