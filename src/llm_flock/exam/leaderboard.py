"""The leaderboard: a file for each row, and a page that is made from these files alone."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from datetime import date
from pathlib import Path
from typing import Any, cast

from llm_flock.errors import InputError
from llm_flock.exam.ask import Outcome
from llm_flock.exam.figures import exam_figures
from llm_flock.exam.questions import SECTIONS
from llm_flock.exam.results import Sitting
from llm_flock.experiments.store import write_whole
from llm_flock.llm.providers import parse_model
from llm_flock.printable import one_line
from llm_flock.runtime.versions import versions

PAGE = "index.md"

MARK = "<!-- Written by `llm-flock exam"
"""Stands in every page that this module writes."""

HEAD = """\
# Which model can fly?

<!-- Written by `llm-flock exam --page docs/leaderboard`; edit the rows' files or the program, not this page. -->

Results of [the exam](../how-to/exam.md): questions of the kinds that robots ask their models, with the prompts, parsers
and checks of a run, scored by code. A share is of the questions that were right at first ask; in brackets, a 95 %
interval by drawing questions again. The total is the mean of the sections that were asked. Rows with fewer questions
have wider intervals, and say how many they had. Tokens are a call's, in and out; seconds are the median of a question.
"""

MODELS = """\
## Models

Each row can be asked again from its recording, without the model: the command of the row, with `replay:` and the file
of its recording in place of the model, gives the same results.
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


MISSIONS = """\
## Whole missions

Flown with the protocol `flock`, each from other starts: without geometry (`hold`), and with it for the robots of models
that stay unusable (`breaker`). Verification, clipping and shield are on in both. *Own waypoints* are those that the
model gave and that were flown as given.
"""

MISSION_COLUMNS: tuple[tuple[str, Callable[[Mapping[str, Any]], str]], ...] = (
    ("team", lambda one: str(one["team"])),
    ("fallback", lambda one: f"{one['fallback']}"),
    ("formed", lambda one: f"{one['formed']} of {one['trials']}"),
    ("by the model alone", lambda one: f"{one['by_models']} of {one['trials']}"),
    ("rounds / bound", lambda one: "-" if one["ratio"] is None else f"{one['ratio']:.2f}"),
    ("broken off", lambda one: str(one["broken"])),
    ("violations", lambda one: str(one["violations"])),
    ("calls", lambda one: "-" if one["calls"] is None else f"{one['calls']:.0f}"),
    ("US dollars a formed mission", lambda one: _money(one["cost_per_formed"])),
    ("own waypoints", lambda one: "-" if one["own_waypoints"] is None else _share(one["own_waypoints"])),
)
"""Columns of whole missions, and what stands in them."""


LONGEST_NAME = 100
"""Longest part of a file's name that stands for a model, which may be a path: its end counts [characters]."""


def slug(model: str) -> str:
    """A model's name as part of a file name."""
    return re.sub(r"[^A-Za-z0-9.]+", "-", model)[-LONGEST_NAME:].strip("-") or "model"


def build_row(
    sitting: Sitting,
    outcomes: Sequence[Outcome],
    *,
    answered_by: str,
    day: date,
    command: str,
    weights: Mapping[str, str],
    seen: Mapping[str, float] | None,
    recording: str | None,
) -> dict[str, Any]:
    """A row as its file holds it: who sat what and when, and the figures.

    Args:
        sitting: the header of the result file.
        outcomes: all of its results.
        answered_by: name and version by which the model called itself.
        day: of the last answer.
        command: that gives this row again.
        weights: digests of weight files of a model on board.
        seen: share of each section whose prompts were taught to this model; None where that is not known.
        recording: file name of the recording beside the row; None for stand-ins, whose answers need none.
    """
    found = exam_figures(outcomes)
    return {
        "model": sitting.setup["model"],
        "answered_by": answered_by,
        "simulated": sitting.simulated,
        "date": day.isoformat(),
        "command": command,
        "recording": recording,
        "exam": {k: v for k, v in asdict(sitting).items() if k != "simulated"},
        "versions": {name: version for name, version in versions().items() if version != "not installed"},
        "weights": dict(weights),
        "seen_in_training": None if seen is None else {k: round(v, 4) for k, v in seen.items()},
        "figures": _rounded(asdict(found)),
    }


def check_page(folder: Path, model: str, split: str, seed: int | None, count: int, *, missions: bool = False) -> None:
    """Check that a row can be written into the folder. Call it before the exam, which may cost money.

    Args:
        folder: of the leaderboard; it may be missing.
        model: as in `--model`.
        split: of the questions.
        seed: of a private split.
        count: questions that the row is about.
        missions: whether it has whole missions too.

    Raises:
        InputError: for field `page`: it is no folder, holds files of somebody else, or a row that is worth more.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError("page", str(folder), "a folder")
    _check_index(folder)
    read_rows(folder)
    target = folder / f"{_stem(model, split, seed)}.json"
    if not target.exists():
        return
    known = _read_row(target)
    if known["model"] != model:
        says = f"{target.name} is the row of {known['model']}, whose name is the same in letters and digits"
        raise InputError("page", str(folder), says=says)
    asked = known["exam"]["count"]
    if asked > count:
        says = f"{target.name} is a row of {asked} questions; one of {count} goes into another folder"
        raise InputError("page", str(folder), says=says)
    if known.get("missions") and not missions:
        says = f"{target.name} has whole missions; add --missions, or write into another folder"
        raise InputError("page", str(folder), says=says)


def publish(folder: Path, row: Mapping[str, Any], recording: Path | None) -> list[Path]:
    """Write a row's files into the folder, and the page, each of them whole; returns what was written.

    Raises:
        InputError: as `check_page`.
        RecordError: a file cannot be written.
    """
    exam = row["exam"]
    missions = bool(row.get("missions"))
    check_page(folder, row["model"], exam["split"], exam["seed"], exam["count"], missions=missions)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        content = None if recording is None or not row["recording"] else recording.read_bytes()
    except OSError as error:
        raise InputError("page", str(folder), f"a folder that can be written to ({error.strerror})") from None
    target = folder / f"{_file_stem(row)}.json"
    written = [target]
    if content is not None:  # before the row that names it
        written.append(folder / row["recording"])
        write_whole(written[-1], content)
    write_whole(target, (json.dumps(row, indent=1) + "\n").encode())
    return [*written, write_page(folder)]


def recording_name(sitting: Sitting) -> str:
    """File name of a row's recording."""
    return f"{_stem(sitting.setup['model'], sitting.split, sitting.seed)}.cassette.jsonl"


def write_page(folder: Path) -> Path:
    """Write the page from the rows' files in its folder.

    Raises:
        InputError: for field `page`: there is no such folder, a file in it is no row, or its page is of somebody else.
        RecordError: the page cannot be written.
    """
    if not folder.is_dir():
        raise InputError("page", str(folder), "a folder that is there, with the rows of a leaderboard")
    _check_index(folder)
    page = folder / PAGE
    write_whole(page, page_text(read_rows(folder)).encode())
    return page


def _check_index(folder: Path) -> None:
    """Refuse to write over a page that was not made here."""
    page = folder / PAGE
    try:
        text = page.read_text(encoding="utf-8") if page.exists() else MARK
    except (OSError, UnicodeDecodeError):
        text = ""
    if MARK not in text:
        raise InputError("page", str(folder), says=f"its {PAGE} was not written by this command, and is left alone")


def read_rows(folder: Path) -> list[dict[str, Any]]:
    """All rows of a folder, the best first.

    Raises:
        InputError: for field `page`: a file in it is no row.
    """
    rows = [_read_row(path) for path in sorted(folder.glob("*.json"))]
    return sorted(rows, key=lambda row: (-row["figures"]["total"]["value"], row["model"]))


def _read_row(path: Path) -> dict[str, Any]:
    try:
        row = cast("dict[str, Any]", json.loads(path.read_text(encoding="utf-8")))
        page_text([row])  # finds every field that is missing, or of a wrong kind
        _ = row["model"] + "", row["exam"]["count"] + 0, row["figures"]["total"]["value"] + 0
    except (
        OSError,
        ValueError,
        ArithmeticError,
        LookupError,
        TypeError,
        AttributeError,
        RecursionError,
        InputError,
    ) as error:
        why = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise InputError("page", str(path), f"a row of the leaderboard ({why})") from None
    return row


def page_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """The page in Markdown."""
    models = [row for row in rows if not _stand_in(row)]
    stand_ins = [row for row in rows if _stand_in(row)]
    parts = [HEAD, MODELS, _table(models) if models else "No model has sat the exam yet.\n"]
    if models:
        parts += ["\n### Where it gets hard\n", _difficulty(models), "\n### How they were asked\n", _settings(models)]
    parts += [STAND_INS, _table(stand_ins), "\n### How they were asked, stand-ins\n", _settings(stand_ins)]
    flown = [row for row in (*models, *stand_ins) if row.get("missions")]
    parts += [MISSIONS, _missions(flown)] if flown else []
    return "\n".join(parts)


def _missions(rows: Sequence[Mapping[str, Any]]) -> str:
    header = ["Model", *(name for name, _ in MISSION_COLUMNS)]
    lines = [_line(header), _line(["---"] * len(header))]
    for row in rows:
        name = f"`{row['model']}`" + (" *simulated*" if row["simulated"] else "")
        lines += [_line([name, *(text(found) for _, text in MISSION_COLUMNS)]) for found in row["missions"]]
    return "\n".join(lines) + "\n"


def _money(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"


def _stand_in(row: Mapping[str, Any]) -> bool:
    return bool(row["simulated"]) or row["model"] == "geometry"


def _table(rows: Sequence[Mapping[str, Any]]) -> str:
    header = ["Model", "Total", "After two reasons", *SECTIONS, "Questions", "Tokens a call", "Seconds", "US dollars"]
    lines = [_line(header), _line(["---"] * len(header))]
    for row in rows:
        found, use = row["figures"], row["figures"]["use"]
        name = f"`{row['model']}`" + (" *simulated*" if row["simulated"] else "")
        cells = [name, _interval(found["total"]), _share(found["total_two"]["value"])]
        for section in SECTIONS:
            asked = found["sections"].get(section)
            cells.append("-" if asked is None else _share(asked["first"]["value"]))
        tokens = (use["tokens_input"] + use["tokens_output"]) / max(1, use["calls"])
        cost = "not known" if use["cost_usd"] is None else f"{use['cost_usd']:.2f}"
        cells += [str(row["exam"]["count"]), f"{tokens:.0f}", f"{use['seconds']:.2f}", cost]
        lines.append(_line(cells))
    return "\n".join(lines) + "\n"


def _difficulty(rows: Sequence[Mapping[str, Any]]) -> str:
    """Shares by size and distance, for every model."""
    header = ["Model", "Section", "Size or distance", "Questions", "First ask", "Median error"]
    lines = [_line(header), _line(["---"] * len(header))]
    for row in rows:
        for kind, unit in (("sizes", "places"), ("distances", "step limits")):
            for section, bands in row["figures"][kind].items():
                for band, found in bands.items():
                    error = "-" if found["error"] is None else f"{found['error']:.2f}"
                    cells = [f"`{row['model']}`", section, f"{band} {unit}", str(found["questions"])]
                    lines.append(_line([*cells, _interval(found["first"]), error]))
    return "\n".join(lines) + "\n\nThe error of a plan is in spacings, that of a step or a path in step limits.\n"


def _settings(rows: Sequence[Mapping[str, Any]]) -> str:
    header = ["Model", "Answered by", "Split", "Date", "Command", "Recording", "Taught"]
    lines = [_line(header), _line(["---"] * len(header))]
    for row in rows:
        exam = row["exam"]
        split = exam["split"] if exam["seed"] is None else f"{exam['split']}, seed {exam['seed']}"
        recording = "-" if row["recording"] is None else f"`{row['recording']}`"
        taught = "-"
        if row["seen_in_training"] is not None:
            shares = [f"{name} {_share(share)}" for name, share in row["seen_in_training"].items() if share]
            taught = ", ".join(shares) or "none"
        cells = [f"`{row['model']}`", f"`{row['answered_by']}`", f"v{exam['version']} {split}", row["date"]]
        lines.append(_line([*cells, f"`{row['command']}`", recording, taught]))
    return "\n".join(lines) + "\n\n*Taught*: share of the questions whose prompt was in the adapter's training set.\n"


def _line(cells: Sequence[str]) -> str:
    # Names come from providers: none of them may end a cell or a row.
    return f"| {' | '.join(one_line(cell).replace('|', '&#124;') for cell in cells)} |"


def _share(value: float) -> str:
    return f"{100 * value:.0f} %"


def _interval(estimate: Mapping[str, float]) -> str:
    return f"{_share(estimate['value'])} [{100 * estimate['low']:.0f}, {100 * estimate['high']:.0f}]"


def _file_stem(row: Mapping[str, Any]) -> str:
    return _stem(row["model"], row["exam"]["split"], row["exam"]["seed"])


def _stem(model: str, split: str, seed: int | None) -> str:
    parse_model(model)
    return slug(model) if split == "public" else f"{slug(model)}-private-{seed}"


def _rounded(value: Any) -> Any:
    """Numbers with six decimals, at every depth, so that files do not differ by the last digit of a machine."""
    if isinstance(value, dict):
        return {name: _rounded(part) for name, part in cast("dict[str, Any]", value).items()}
    return round(value, 6) if isinstance(value, float) else value
