"""Tables in a narrow terminal: no word is cut, and what is to be copied stays in one piece."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.table import Table
from sweeps import small_file
from typer.testing import CliRunner

from llm_flock.cli import app
from llm_flock.cli._terminal import Screen
from llm_flock.llm._providers import PROVIDERS

WORDS = ("short", "a longer text of several words", "https://a.very.long.address.example/with/a/path")


def shown(table: Table, width: int, copied: tuple[str, ...] = ()) -> str:
    screen = Screen(file=io.StringIO(), width=width, color_system=None)
    screen.show(table, copied)
    assert isinstance(screen.file, io.StringIO)
    return screen.file.getvalue()


def table_of() -> Table:
    table = Table("name", "words", "address", title="a title")
    table.add_row(*WORDS)
    return table


def test_a_table_that_fits_is_one() -> None:
    text = shown(table_of(), 120)
    assert "┃" in text and all(word in text for word in WORDS) and len(text.splitlines()) == 6


@pytest.mark.parametrize("width", range(20, 121, 7))
def test_no_width_cuts_a_word(width: int) -> None:
    text = shown(table_of(), width, copied=("address",))
    assert "…" not in text and WORDS[2] in text
    assert all(word in text.replace("│", " ").split() for word in WORDS[1].split())
    if "┃" in text:
        assert max(map(len, text.splitlines())) <= width, "a table that a terminal breaks is no table"


def test_units_in_headers_are_no_markup() -> None:
    table = Table("name", r"way \[m]")
    table.add_row("a", "1.0")
    assert "way [m]" in shown(table, 80) and "way [m]" in shown(table, 10)


def test_a_list_of_names_and_values_is_not_cut_either() -> None:
    table = Table(show_header=False)
    table.add_row("record", "[green]" + "x" * 90 + "[/]")
    assert shown(table, 80) == "record  " + "x" * 90 + "\n"


def test_models_can_be_copied_in_80_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    text = CliRunner().invoke(app, ["models"]).stdout
    for provider in PROVIDERS.values():
        assert {provider.example, provider.key_env} <= set(text.split())


def test_a_column_that_does_not_wrap_is_not_cut() -> None:
    table = Table("cell", "calls")
    table.columns[1].no_wrap = True
    table.add_row("a cell of many words", "10.81 M")
    assert all("10.81 M" in shown(table, width) for width in range(12, 60))


@pytest.mark.parametrize("columns", ["24", "60", "80"])
@pytest.mark.parametrize("line", ["run --shape triangle --robots 3 --dry-run", "sweep FILE --dry-run"])
def test_no_command_cuts_its_table(columns: str, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    found = CliRunner().invoke(app, line.replace("FILE", str(small_file(tmp_path))).split())
    assert (found.exit_code, found.stdout.count("…")) == (0, 0), found.stdout


@pytest.mark.parametrize("columns", ["60", "80", "110"])
@pytest.mark.parametrize("name", ["run", "compare", "fly", "swarm"])
def test_help_cuts_no_flag(name: str, columns: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    text = CliRunner().invoke(app, [name, "--help-all"]).stdout
    assert "…" not in text and f"Usage: llm-flock {name}" in text and "--reasoning-effort" in text
