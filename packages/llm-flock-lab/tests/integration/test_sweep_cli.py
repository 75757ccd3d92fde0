"""`llm-flock sweep` as a user types it."""

import json
from pathlib import Path

import pytest
from sweeps import small_file
from typer.testing import CliRunner

from llm_flock.cli import app
from llm_flock.errors import InputError


def sweep(*arguments: str, code: int = 0) -> str:
    done = CliRunner().invoke(app, ["sweep", *arguments])
    if isinstance(done.exception, InputError):
        raise done.exception
    assert done.exit_code == code, done.output
    return done.stdout


def test_a_dry_run_forecasts_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = small_file(tmp_path, more="[budget]\nmax_cost = 3.0")
    found = json.loads(sweep(str(path), "--dry-run", "--json", "--model", "openai:gpt-4o"))
    assert (found["trials"], found["left"]) == (4, 4) and found["expected"]["cost_usd"] > 0
    assert set(found["cells"]) == {"triangle/3 flock", "triangle/3 baseline"}
    text = sweep(str(path), "--dry-run", "--model", "openai:gpt-4o")
    assert "4 trials, 0 of them flown" in text and "Budget: 3.0 US dollars" in text and "list prices" in text
    assert list(tmp_path.iterdir()) == [path]


def test_the_papers_models_are_forecast_without_keys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for key in ("OPENAI_API_KEY", "ANTHROPIC_API_KEY", "DEEPSEEK_API_KEY", "DASHSCOPE_API_KEY", "VLLM_API_KEY"):
        monkeypatch.delenv(key, raising=False)
    path = Path(__file__).parents[4] / "experiments" / "paper.toml"
    found = json.loads(sweep(str(path), "--dry-run", "--json", "--set", "team=triangle/3", "--seeds", "1"))
    assert found["trials"] == len(found["cells"]) == 20 and found["expected"]["calls"] > 0
    assert {name.split()[1] for name in found["cells"]} == {"paper", "released", "flock", "baseline"}
    assert len({name.split()[2] for name in found["cells"]}) == 5


def test_sweep_flies_resumes_and_reports_its_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = small_file(tmp_path)
    one = ("--executor", "one", "-q")
    assert "0 broken off" in sweep(str(path), "--budget-calls", "40", "-q", code=1)
    assert json.loads(sweep(str(path), *one, "--json", "--keep-records", "all"))["complete"] is True
    assert "4 of 4 trials: 2 formed" in sweep(str(path), *one)
    assert (tmp_path / "runs/small/trials.parquet").exists()
    assert "4 of them flown" in sweep(str(path), "--dry-run")


def test_variables_and_choices_are_read(tmp_path: Path) -> None:
    path = small_file(tmp_path, grid='loss = "$losses"', more="[variables]\nlosses = [0.0]")
    given = ("--set", "losses=0.1", "--set", "losses=0.2")
    cells = json.loads(sweep(str(path), "--dry-run", "--json", *given))["cells"]
    assert list(cells)[-1] == "triangle/3 baseline loss=0.2"
    with pytest.raises(InputError, match="--set losses: expected NAME=VALUE"):
        sweep(str(path), "--set", "losses")
    for wrong in (("--executor", "two"), ("--keep-records", "some")):
        sweep(str(path), *wrong, code=2)
