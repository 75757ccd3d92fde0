"""A dry run refuses the models that the run itself would refuse, and needs no key."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from sweeps import small_file
from typer.testing import CliRunner

from llm_flock.cli import app
from llm_flock.errors import InputError

ABSENT = ("replay:nofile", "local:nope.gguf", "my_absent_module:Nope")


def refusal(*argv: str) -> str:
    error = CliRunner().invoke(app, argv).exception
    assert isinstance(error, InputError), error
    return str(error)


@pytest.mark.parametrize("model", ABSENT[:2])
def test_a_dry_run_refuses_what_the_run_refuses(model: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    team = ("--shape", "triangle", "--robots", "3", "--model", model)
    real = refusal("run", *team, "--no-record")
    assert refusal("run", *team, "--dry-run") == real
    sweep = ("sweep", str(small_file(tmp_path)), "--model", model)
    assert refusal(*sweep, "--dry-run") == refusal(*sweep)
    assert refusal("fly", "--dry-run", "--model", model) == real


@pytest.mark.parametrize("model", ABSENT)
def test_a_refused_comparison_leaves_no_file(model: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    refusal("compare", "--cells", "triangle/3", "--trials", "1", "--model", model, "--out", "x.csv")
    assert not Path("x.csv").exists()


@pytest.mark.parametrize("command", ["run", "sweep"])
def test_a_dry_run_imports_no_class_of_the_users(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "users_code.py").write_text("raise SystemExit('imported')\n")
    own = ("--model", "users_code:Model", "--consensus", "users_code:Rule", "--assignment", "users_code:Rule")
    line = ("run", "--shape", "triangle", "--robots", "3") if command == "run" else ("sweep", str(small_file(tmp_path)))
    done = CliRunner().invoke(app, [*line, *own, "--dry-run"])
    assert done.exit_code == 0 and "users_code" not in sys.modules, done.output


def test_dry_run_needs_no_key_but_a_price_with_a_cost_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENAI_API_KEY", raising=False)
    team = ("run", "--shape", "triangle", "--robots", "3", "--dry-run")
    assert CliRunner().invoke(app, [*team, "--model", "openai:o3-mini", "--json"]).exit_code == 0
    unpriced = refusal(*team, "--model", "openai:no-such-model", "--max-cost", "1")
    assert "models with a known price, not openai:no-such-model" in unpriced
