"""Figures in the docs are known by their files, with what they depend on; those that the README shows are current."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from benchmarks import figures

ROOT = Path(__file__).parents[2]


def test_every_row_depends_on_what_there_is() -> None:
    assert {figures.state(row) for row in figures.rows()} <= {"current", "stale", "undated", "by hand"}


def test_files_of_figures_that_the_readme_shows_are_current() -> None:
    shown = set(re.findall(r"docs/data/([\w-]+\.csv)", (ROOT / "README.md").read_text(encoding="utf-8")))
    assert not shown & set(figures.stale())


@pytest.fixture
def measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of code on which a stamped file of figures depends."""
    monkeypatch.setattr(figures, "ROOT", tmp_path)
    monkeypatch.setattr(figures, "TABLE", tmp_path / "commands.csv")
    (tmp_path / "code.py").write_text("x = 1\n")
    rows = "File,Command,Depends on,Version,Digest\na.csv,make a,code.py,,\nb.csv,by eye,,,\n"
    (tmp_path / "commands.csv").write_text(rows)
    assert figures.stale() == ["a.csv"]
    figures.stamp("a.csv")
    assert figures.stale() == []
    figures._digest_of.cache_clear()
    return tmp_path / "code.py"


def test_figures_are_older_than_code_that_does_something_else(measured: Path) -> None:
    measured.write_text("x = 2\n")
    assert figures.stale() == ["a.csv"]


def test_comments_and_docstrings_leave_figures_current(measured: Path) -> None:
    measured.write_text('"""What it is."""\n\nx = 1  # one\n')
    assert figures.stale() == []


def test_what_is_missing_is_named(measured: Path) -> None:
    with pytest.raises(ValueError, match=r"c\.csv: no row"):
        figures.stamp("c.csv")
    measured.unlink()
    with pytest.raises(FileNotFoundError, match=r"code\.py: expected one of"):
        figures.stale()
