"""The paper's figures, claims and failures, from a small sweep that is flown here; and the draft of a section."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.text import Text
from sample_records import make_record
from sample_results import trial, write_results

from llm_flock.errors import InputError
from llm_flock.record import RunRecord, read_record
from llm_flock_lab._cli.report import report as report_command
from llm_flock_lab._experiments.store import Store
from llm_flock_lab._experiments.sweep import fly_sweep
from llm_flock_lab._experiments.sweep_file import load_sweep
from llm_flock_lab._experiments.tex import to_tex
from llm_flock_lab._report import page
from llm_flock_lab._report.claims import CLAIMS, TEAMS, PaperEvidence, _above, _verdict, claims_sheet
from llm_flock_lab._report.drawings import ReportDrawing, draw_all
from llm_flock_lab._report.page import write_report
from llm_flock_lab._report.paper import draw_paper, evidence_of, paper_failures
from llm_flock_lab._report.results import Results

SWEEP = """
[sweep]
name = "few"
about = "Both failures & what 100 % of a_b means."
seeds = 2
keep_records = "all"
[grid]
team = ["triangle/3"]
protocol = ["paper", "baseline"]
model = ["simulated:ideal", "simulated:distorted", "simulated:overshoot"]
[run.trial]
start = "uniform"
rounds = 40
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("few")
    (folder / "few.toml").write_text(SWEEP, encoding="utf-8")
    fly_sweep(load_sweep(folder / "few.toml"), folder / "runs", executor="one", jobs=1, at_once=8)
    return folder


@pytest.fixture(scope="module")
def results(folder: Path) -> Results:
    return Results.read(folder / "runs")


@pytest.fixture(scope="module")
def report(folder: Path) -> Path:
    """A report whose figures are files without a drawing, as embedding fonts takes most of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "save", lambda _, path: touched(path))
        write_report(folder / "runs", folder / "report", most=0, formats=["pdf"])
    return folder / "report"


def touched(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()


def verdicts(found: Results, protocol: str) -> dict[str, tuple[str, str]]:
    """Verdict and figures by claim."""
    sheet = claims_sheet([PaperEvidence(results=found, protocol=protocol, reference="baseline")])
    return {text: (word, figures) for text, _, _, word, figures in sheet.rows}


MAIN = next(claim.text for claim in CLAIMS if claim.lines == "456-510")


def test_more_formed_and_nearer_is_reproduced_and_counted(tmp_path: Path) -> None:
    found = Results.read(write_results(tmp_path, records=False))
    word, figures = verdicts(found, "flock")[MAIN]
    assert (
        word == "reproduced" and "triangle 3: in shape +83.3 [" in figures and "circle 10: in shape +83.3 [" in figures
    )


def test_a_cell_without_a_difference_is_named(tmp_path: Path) -> None:
    found = Results.read(write_results(tmp_path, records=False))
    word, figures = verdicts(found, "paper")[MAIN]
    assert word == "undecided"
    assert figures.startswith("undecided in triangle 3: in shape +0.0") and "undecided in circle 10" in figures


@pytest.mark.parametrize(
    ("low", "high", "threshold", "word"),
    [
        (0.51, 0.9, 0.5, "reproduced"),
        (0.5, 0.9, 0.5, "undecided"),
        (0.1, 0.49, 0.5, "not reproduced"),
        (None, None, 0.0, "undecided"),
    ],
)
def test_an_interval_decides_or_does_not(low: float | None, high: float | None, threshold: float, word: str) -> None:
    cells = [("a", (True, "yes")), ("b", (_above(low, high, threshold), "perhaps"))]
    assert _verdict(cells)[0] == word
    assert _verdict([*cells, ("c", (False, "no"))])[0] == "not reproduced"


def test_a_claim_about_named_models_needs_these(results: Results, tmp_path: Path) -> None:
    (text,) = (claim.text for claim in CLAIMS if "DeepSeek" in claim.text)
    assert verdicts(results, "paper")[text] == ("cannot be tested without these models", "")
    found = Results.read(write_results(tmp_path / "real", records=False))
    errors = {"openai:o3-mini": lambda seed: 1.0 + seed / 9, "qwen:qwen-max": lambda seed: 3.0}
    found.__dict__["trials"] = tuple(
        replace(t, cell=replace(t.cell, model=name), figures={**t.figures, "procrustes_mean": error(t.seed)})
        for t in found.trials
        for name, error in errors.items()
    )
    word, figures = verdicts(found, "flock")[text]
    assert word == "reproduced" and "triangle 3: error −1.72" in figures


@pytest.mark.parametrize(("scale", "word"), [(0.1, "reproduced"), (1.0, "undecided"), (3.0, "not reproduced")])
def test_spreads_are_compared_seed_by_seed(scale: float, word: str, tmp_path: Path) -> None:
    found = Results.read(write_results(tmp_path, records=False))
    wide = (2.0, 5.0, 3.5, 4.0, 2.5, 6.0)
    found.__dict__["trials"] = tuple(
        replace(
            t, figures={**t.figures, "procrustes_mean": wide[t.seed] * (scale if t.cell.protocol == "flock" else 1.0)}
        )
        for t in found.trials
    )
    (text,) = (claim.text for claim in CLAIMS if "vary" in claim.text)
    said = verdicts(found, "flock")[text]
    assert said[0] == word and f"standard deviation {1.3744 * scale:.2f}" in said[1]


def test_both_failures_are_found_with_the_answers_behind_them(results: Results) -> None:
    evidence = evidence_of(results, "baseline", ())
    faulty, fast = paper_failures(evidence, fly_again=False)
    assert (faulty.name, fast.name) == ("paper-faulty-plan", "paper-full-speed")
    assert faulty.trial.cell.model == "simulated:distorted" and fast.trial.cell.model == "simulated:overshoot"
    for failure, answer in ((faulty, "Plan: [["), (fast, "Position: [")):
        (story,) = failure.stories
        (said,) = (line.text for line in story.conversation if line.role == "assistant")
        assert answer in said and failure.figure is not None
    numbers = re.findall(r"([\d.]+) units away, and its model steps ([\d.]+):", fast.stories[0].text)
    ((distance, step),) = [(float(a), float(b)) for a, b in numbers]
    assert step > 5.9 and step > distance


def test_failures_are_verdicts_where_models_err_so(results: Results) -> None:
    found = verdicts(results, "paper")
    (plan,) = (claim.text for claim in CLAIMS if claim.lines == "654")
    (step,) = (claim.text for claim in CLAIMS if claim.lines == "676, 744")
    assert found[plan][0] == found[step][0] == "reproduced"
    assert found[plan][1].endswith("with simulated:distorted") and found[step][1].endswith("with simulated:overshoot")


def test_stand_in_drones_are_no_drones(results: Results, tmp_path: Path) -> None:
    record = read_record(make_record(tmp_path / "run.mcap", n=5, rounds=6))
    sheet = claims_sheet(evidence_of(results, "baseline", [record]))
    assert sheet.rows[-1][2:] == ("flights", "cannot be tested without drones", "stand-ins: circle 5 formed in round 6")


def fonts(drawings: Sequence[ReportDrawing]) -> dict[str, float]:
    """The smallest letters of each figure [points]."""
    sizes = {}
    for drawing in drawings:
        drawing.figure.canvas.draw()
        texts = [one for one in drawing.figure.findobj(Text) if isinstance(one, Text) and one.get_text().strip()]
        sizes[drawing.name] = min(text.get_fontsize() for text in texts if text.get_visible())
    return sizes


def test_figures_fit_a_column_or_a_page_with_readable_letters(results: Results, record: RunRecord) -> None:
    drawings = [*draw_all(results, "baseline"), *draw_paper(evidence_of(results, "baseline", [record]), False)]
    assert {one.name for one in drawings} >= {
        "success", "paper-error", "paper-error-squared", "paper-triangle-3", "paper-influence", "paper-flights",
    }  # fmt: skip
    assert {one.figure.get_figwidth() for one in drawings} <= {3.5, 7.16}
    assert {name: size for name, size in fonts(drawings).items() if size < 6.0} == {}


@pytest.fixture
def record(tmp_path: Path) -> RunRecord:
    return read_record(make_record(tmp_path / "run.mcap", n=5, rounds=6))


def test_pdf_figures_have_no_type_3_fonts(results: Results, tmp_path: Path) -> None:
    drawn = [*draw_all(results, "baseline"), *draw_paper(evidence_of(results, "baseline", []), False)]
    for drawing in (drawn[0], drawn[-1]):  # all are written by `save`
        page.save(drawing.figure, tmp_path / "figure.pdf")
        data = (tmp_path / "figure.pdf").read_bytes()
        assert b"/Type3" not in data and b"/FontFile2" in data, drawing.name


def test_draft_names_figures_that_exist_and_right_numbers(report: Path, results: Results) -> None:
    tex, markdown = ((report / f"draft.{ending}").read_text(encoding="utf-8") for ending in ("tex", "md"))
    shown = re.findall(r"\\includegraphics\[width=\\(?:textwidth|columnwidth)\]\{(.+?)\}", tex)
    assert "figures/paper-error.pdf" in shown and "figures/paper-full-speed.pdf" in shown
    assert all((report / name).is_file() for name in shown)
    assert all(f"]({name})" in markdown for name in shown)
    formed = sum(trial.formed for trial in results.trials if trial.cell.protocol == "paper")
    assert f"With paper, {formed} of 6 trials formed." in markdown and f"With paper, {formed} of 6" in tex
    assert "These are simulated: programs" in " ".join(tex.split()) and "Simulated language models." in tex
    assert "two robots came nearer than the safe distance" in " ".join(tex.split())
    assert "Starts: uniform" in markdown and "Most rounds of a trial: 40" in markdown


@pytest.mark.parametrize("name", ["draft.tex", "tables.tex"])
def test_latex_closes_what_it_opens(report: Path, name: str) -> None:
    tex = (report / name).read_text(encoding="utf-8")
    plain = re.sub(r"\\[\\{}%&#_$]", "", tex)
    assert plain.count("{") == plain.count("}") and plain.count("$") % 2 == 0
    opened = re.findall(r"\\begin\{(.+?)\}", tex)
    assert sorted(opened) == sorted(re.findall(r"\\end\{(.+?)\}", tex)) and opened.count("tabular") >= 4
    for table in re.findall(r"\\toprule\n(.*?)\\bottomrule", tex, flags=re.S):
        widths = {line.count(" & ") for line in table.splitlines() if line.endswith(r"\\")}
        assert len(widths) == 1 and widths != {0}
    columns = [float(width) for width in re.findall(r"p\{(-?[\d.]+)(?:\\textwidth|em)\}", tex)]
    assert min(columns) >= 0.06, "words have room"


def test_signs_of_latex_are_escaped() -> None:
    assert to_tex("100 % of a_b & {c} #1 $2 ~ ^ \\") == (
        r"100 \% of a\_b \& \{c\} \#1 \$2 \textasciitilde{} \textasciicircum{} \textbackslash{}"
    )
    assert to_tex("−1 · ²\n漢") == "$-$1 $\\cdot$ $^2$ ?"


def test_claims_are_a_file_too(report: Path) -> None:
    with (report / "claims.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["claim"] for row in rows} == {claim.text for claim in CLAIMS}
    assert {row["verdict"].partition(" without")[0] for row in rows} <= {
        "reproduced",
        "not reproduced",
        "undecided",
        "cannot be tested",
    }


def test_other_sweeps_have_a_draft_and_no_section_of_the_paper(tmp_path: Path) -> None:
    for protocol in ("flock", "paper"):
        Store(tmp_path / "results").save(trial("circle", 10, protocol, 1))
    write_report(tmp_path / "results", tmp_path, reference="flock", most=0, formats=["svg"])
    assert not (tmp_path / "claims.csv").exists() and not (tmp_path / "draft.tex").exists()
    draft = (tmp_path / "draft.md").read_text(encoding="utf-8")
    assert "figures/success.svg" in draft and "simulated" not in draft and "The claims of the paper" not in draft


def test_a_folder_without_flights_is_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a folder with folders in which there is a run\.mcap"):
        report_command(folder / "runs", tmp_path, flights=folder)
    assert not list(tmp_path.iterdir())


def test_evidence_needs_the_papers_teams_and_its_baseline(results: Results) -> None:
    assert [one.protocol for one in evidence_of(results, "baseline", ())] == ["paper"]
    assert evidence_of(results, "paper", ()) == []
    assert TEAMS[0] in results.teams
