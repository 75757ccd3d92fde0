"""Writes the report: one self-contained HTML page, the same in Markdown, and a folder of figures."""

# Matplotlib's types leave **kwargs open.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import base64
import csv
import io
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import jinja2
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from llm_flock.errors import InputError, unknown
from llm_flock.printable import csv_cell, printable
from llm_flock.record import ENDINGS, answers_of_others, read_record
from llm_flock_lab._experiments.store import write_whole
from llm_flock_lab._experiments.tex import to_tex
from llm_flock_lab._report import sheets
from llm_flock_lab._report.claims import claims_sheet
from llm_flock_lab._report.draft import draft_values
from llm_flock_lab._report.drawings import ReportDrawing, draw_all
from llm_flock_lab._report.findings import caveats, cell_lines, pair_lines, usual_reference
from llm_flock_lab._report.gallery import Failure, gallery
from llm_flock_lab._report.paper import draw_paper, evidence_of, paper_failures
from llm_flock_lab._report.results import Results
from llm_flock_lab._report.sheets import Sheet
from llm_flock_view._figures.figures import save
from llm_flock_view._figures.style import FAINT, GRID, INK, PAPER, RC, SERIES, SERIES_ON_DARK, house_style

FORMATS = ("svg", "pdf", "png")

DRAFT = "A draft, written by llm-flock report from the results alone. Check every sentence before you use it."

TABLES = "draft_tables.j2"  # template of all tables of the page in LaTeX

SECTIONS = {
    "success": "Success",
    "error": "Error over time",
    "paired": "Protocols compared",
    "axes": "Along the grid",
    "rounds": "Rounds over the lower bound",
    "separation": "Separation",
    "paper": "The paper's figures and claims",
    "spending": "Calls, tokens and money",
    "failures": "Failures",
    "data": "Data and code",
}

VARIABLES: dict[str, tuple[str, str]] = {
    INK: ("ink", "#E6E6E6"),
    PAPER: ("paper", "#17191C"),
    GRID: ("grid", "#33373C"),
    FAINT: ("faint", "#8A8F95"),
    str(RC["axes.edgecolor"]): ("edge", "#6A7077"),
    **{light: (f"series-{k}", dark) for k, (light, dark) in enumerate(zip(SERIES, SERIES_ON_DARK, strict=True))},
}
"""Colours of figures: for each, the page's CSS variable, and the variable's value on a dark page."""


@dataclass(slots=True, kw_only=True)
class PageSection:
    """A section of the page; `name` is one of `SECTIONS`."""

    name: str
    title: str
    drawings: list[ReportDrawing] = field(default_factory=list[ReportDrawing])
    sheets: list[Sheet] = field(default_factory=list[Sheet])
    failures: list[Failure] = field(default_factory=list[Failure])
    lines: list[str] = field(default_factory=list[str])


def write_report(
    folder: Path,
    out: Path,
    *,
    reference: str | None = None,
    most: int = 6,
    formats: Sequence[str] = FORMATS,
    fly_again: bool = True,
    flights: Sequence[Path] = (),
    on_step: Callable[[str], None] = lambda step: None,
) -> list[Path]:
    """Write the report of a directory of results; files of an older report in the same place are replaced.

    `out` gets `report.html`, `report.md` and `figures/`, with a file of each figure for every ending in `formats`. The
    reference is the baseline by default, where it was flown. The gallery of failures shows `most` trials; for it, those
    of simulated models without a record can be flown again. Where the paper's teams were flown with and without
    consensus, its figures and claims are a section of their own, with the records of `flights`. `draft.md` and
    `draft.tex` are a draft of an experimental section, and `tables.tex` has the tables of the page. `on_step` is called
    with the name of everything made.

    Returns:
        the page, the Markdown, and every figure.

    Raises:
        InputError: no results, or an option out of its range.
        RecordError: a trial is damaged, or a flight cannot be read.
    """
    if not formats or any(ending not in FORMATS for ending in formats):
        raise InputError("formats", ",".join(formats), f"some of {', '.join(FORMATS)}")
    results = Results.read(folder)
    if reference is not None and reference not in results.references:
        raise InputError("reference", reference, says=unknown("protocol or AXIS=VALUE", reference, results.references))
    records = [read_record(path) for path in flights]
    written: list[Path] = []

    def keep(figure: Figure, name: str) -> None:
        for ending in formats:
            save(figure, out / "figures" / f"{name}.{ending}")
            written.append(out / "figures" / f"{name}.{ending}")
        on_step(name)

    sections = {name: PageSection(name=name, title=title) for name, title in SECTIONS.items()}
    reference = reference or usual_reference(results)
    evidence = evidence_of(results, reference, records)
    for drawing in (*draw_all(results, reference), *draw_paper(evidence, fly_again)):
        sections[drawing.section].drawings.append(drawing)
        keep(drawing.figure, drawing.name)
    claims = claims_sheet(evidence) if evidence else None
    if claims is not None:
        sections["paper"].sheets.append(claims)
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([map(csv_cell, row) for row in (claims.header, *claims.rows)])
        write_whole(out / "claims.csv", text.getvalue().encode())
        written.append(out / "claims.csv")
    lines = cell_lines(results)
    sections["success"].sheets.append(sheets.success_sheet(results, lines))
    sections["rounds"].sheets.append(sheets.flight_sheet(results, lines))
    sections["spending"].sheets.append(sheets.spending_sheet(results, lines))
    pairs = pair_lines(results, reference)
    if pairs:
        sections["paired"].sheets += sheets.pair_sheets(results, pairs, reference)
    sections["paper"].failures += paper_failures(evidence, fly_again)
    failures = sections["failures"].failures
    failures += gallery(results, most, fly_again=fly_again)
    for failure in (*sections["paper"].failures, *failures):
        if failure.figure is not None:
            keep(failure.figure, failure.name)
    sections["failures"].lines.append(_failure_words(results, len(failures)))
    codes = ", ".join(dict.fromkeys(str(trial.figures["code"]) for trial in results.trials))
    tables = "The two tables, trials.parquet and rounds.parquet, lie beside sweep.toml, which repeats the sweep."
    sections["data"].lines += [f"Flown by: {codes}.", tables]
    page: dict[str, Any] = {
        "title": results.name,
        "about": results.about,
        "subtitle": _subtitle(results),
        "warnings": list(_warnings(results)),
        "facts": sheets.facts(results, lines),
        "sections": [s for s in sections.values() if s.drawings or s.sheets or s.failures or s.lines],
        "footer": "Made by llm-flock report from trials.parquet and rounds.parquet.",
        "light": {name: colour for colour, (name, _) in VARIABLES.items()},
        "dark": dict(VARIABLES.values()),
        "picture_format": "svg" if "svg" in formats else formats[0],
    }
    drawings = [drawing for section in sections.values() for drawing in section.drawings]
    page |= draft_values(results, lines, pairs, drawings, claims)
    page |= {"banner": DRAFT, "reference": reference, "failures": sections["paper"].failures}
    files = {"draft.tex": "draft_tex.j2", "tables.tex": TABLES} if "pdf" in formats else {}
    files |= {"draft.md": "draft_md.j2", "report.html": "page.html.j2", "report.md": "page.md.j2"}
    for name, template in files.items():
        text = _template(template).render({"kind": template} | page)
        write_whole(out / name, re.sub(r"\n{3,}", "\n\n", text).encode())
        written.insert(0, out / name)
        on_step(name)
    return written


def inline_svg(figure: Figure, name: str, label: str) -> Markup:
    """The figure as an element of a page, always the same; `name` begins every id, `label` is for screen readers."""
    out = io.StringIO()
    with house_style():
        figure.savefig(out, format="svg", metadata={"Date": None})
    text = out.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    # Its style sheet would hold for the whole page.
    text = re.sub(r"<style.*?</style>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", text)
    text = re.sub(r'\bhref="#([^"]+)"', rf'href="#{name}-\1"', text)
    for colour, (variable, _) in VARIABLES.items():
        text = re.sub(re.escape(colour), f"var(--{variable})", text, flags=re.IGNORECASE)
    box = re.search(r'viewBox="([^"]+)"', text)
    assert box is not None, "matplotlib writes a view box"
    width = float(box[1].split()[2])
    # On a phone, words keep the size of a figure on paper, and what is wider is scrolled.
    size = f"max-width:{width * 1.25:.0f}px;min-width:{width:.0f}px"
    head = (
        f'<svg viewBox="{box[1]}" role="img" aria-label="{escape(label)}" style="{size}" '
        'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink">'
    )
    return Markup(head + text[text.index(">", text.index("<svg")) + 1 :].strip())  # noqa: S704 - matplotlib escapes


def _svg(drawing: ReportDrawing) -> Markup:
    return inline_svg(drawing.figure, drawing.name, f"{drawing.title}. {drawing.caption}")


def _data_address(figure: Figure) -> str:
    image = io.BytesIO()
    with house_style():
        figure.savefig(image, format="png", dpi=130)
    return f"data:image/png;base64,{base64.b64encode(image.getvalue()).decode('ascii')}"


def _subtitle(results: Results) -> str:
    parts = (
        _count(len(results.trials), "trial"),
        ", ".join(f"{team.shape} {team.n_robots}" for team in results.teams),
        ", ".join(results.protocols),
        ", ".join(results.models),
        _count(len({trial.seed for trial in results.trials}), "seed"),
    )
    return " · ".join(part for part in parts if part)


def _warnings(results: Results) -> Iterator[str]:
    if results.simulated:
        every = all(trial.figures["simulated"] for trial in results.trials)
        yield (
            f"{'Simulated language models' if every else 'Some of the language models are simulated'}: these figures "
            "say something about the protocol, and nothing about language models."
        )
    named = {
        tuple(str(trial.figures.get(name) or "") for name in ("models", "answered_by")) for trial in results.trials
    }
    for words in sorted({said for one in named for said in answers_of_others(*map(str.split, one))}):
        yield f"{words}."
    yield from caveats(results)
    bad = {name: n for name, n in results.outcomes().items() if name not in ("formed", "not formed") and n}
    if bad:
        words = "; ".join(f"{n} {name} ({ENDINGS[name]})" for name, n in bad.items())
        yield f"Trials that came to no proper end: {words}. They are counted as not formed."
    missing = (results.planned or 0) - len(results.trials)
    if missing > 0:
        yield f"The sweep is not finished: {missing:,} of {results.planned:,} trials are still to be flown."
    codes = {str(trial.figures["code"]) for trial in results.trials}
    if len(codes) > 1:
        yield f"The trials were flown by different versions of the code: {', '.join(sorted(codes))}."
    cut = sum(bool(trial.figures.get("cut")) for trial in results.trials)
    if cut:
        yield f"The budget of the sweep ended {_count(cut, 'trial')}: continue the sweep with a larger one."


def _failure_words(results: Results, shown: int) -> str:
    bad = sum(not trial.formed or trial.too_near for trial in results.trials)
    if not bad:
        return "Every trial formed, and no two robots came nearer than the safe distance."
    return (
        f"{bad:,} of {len(results.trials):,} trials did not form or had robots too near; shown are {shown} of them, "
        "the worst of each protocol and each way to end."
    )


def _count(count: int, name: str) -> str:
    return f"{count:,} {name}{'' if count == 1 else 's'}"


def _template(name: str) -> jinja2.Template:
    """A page; those of the draft, Markdown and LaTeX, share their words."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("llm_flock_lab._report"),
        autoescape=jinja2.select_autoescape(["html.j2"]),
        undefined=jinja2.StrictUndefined,
        finalize=_clean,
    )
    filters = cast("dict[str, Any]", environment.filters)
    filters |= {"breakable": _breakable, "md": _markdown, "fenced": _fence, "svg": _svg, "data": _data_address}
    filters["tex"] = to_tex
    if name.startswith("draft"):
        return environment.overlay(trim_blocks=True, lstrip_blocks=True).get_template(
            TABLES if name == TABLES else "draft.j2"
        )
    return environment.get_template(name)


def _clean(value: object) -> str:
    """A value of a page, without characters that turn text around or are invisible."""
    text = printable(str(value))
    return Markup(text) if isinstance(value, Markup) else text  # noqa: S704 - it was markup before


def _breakable(text: str) -> Markup:
    """Text that may be broken after its separators."""
    return Markup(re.sub(r"(?<=[,:@/])", "<wbr>", str(escape(text))))  # noqa: S704 - escaped


def _markdown(text: str) -> str:
    """Plain text for Markdown: on one line, with special characters escaped."""
    return re.sub(r"([\\`*_\[\]<>|#])", r"\\\1", " ".join(str(text).split()))


def _fence(text: str) -> str:
    """Text as a fenced block; it may contain backticks."""
    fence = "`" * max(3, 1 + max((len(run) for run in re.findall(r"`+", text)), default=0))
    return f"{fence}text\n{text}\n{fence}"
