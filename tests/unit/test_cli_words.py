"""What commands say besides their result: what they wait for, replace, or refuse before they begin."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

import pytest
from sample_records import make_record
from sweeps import small
from typer.testing import CliRunner, Result

from llm_flock import extras
from llm_flock.cli import app
from llm_flock.cli._display import live_line
from llm_flock.errors import InputError
from llm_flock.llm._mission_words import MissionReader
from llm_flock.runtime._trial import TrialProgress
from llm_flock_lab._experiments.sweep_file import load_sweep


def call(*argv: object, monkeypatch: pytest.MonkeyPatch) -> Result:
    words = [str(word) for word in argv]
    monkeypatch.setattr("sys.argv", ["llm-flock", *words])
    return CliRunner().invoke(app, words)


def progress(n_robots: int) -> TrialProgress:
    return TrialProgress(
        round=0,
        rounds=9,
        at_goal=0,
        n_robots=n_robots,
        plans_in_use=0,
        distinct_goals=0,
        error=None,
        model_calls=0,
        tokens=0,
        cost_usd=None,
    )


def test_live_line_says_what_it_waits_for_until_a_robot_comes(capsys: pytest.CaptureFixture[str]) -> None:
    bar, show = live_line("circle", enabled=True, waiting="waiting for robots ...")
    with bar:
        show(progress(0))
        show(progress(0))
        show(progress(3))
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "waiting for robots ..." and [line for line in lines[1:] if "at goal" in line] == lines[1:]
    assert len(lines) == 2 and "at goal 0/3" in lines[1]


def test_picture_of_a_broken_run_says_so_and_what_it_replaces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("llm_flock_view._figures.figures.snapshots", lambda record, rounds, **look: None)
    monkeypatch.setattr("llm_flock_view._figures.figures.save", lambda drawn, path: path.touch())
    first = call("figure", make_record(tmp_path / "run.mcap", n=3, rounds=2), monkeypatch=monkeypatch)
    assert (first.exit_code, first.stderr) == (0, "")
    (tmp_path / "run.mcap").unlink()
    path = make_record(tmp_path / "run.mcap", n=3, rounds=2, finish=False)
    again = call("figure", path, monkeypatch=monkeypatch)
    picture = tmp_path / "snapshots.png"
    assert (again.exit_code, again.stdout) == (0, f"{picture}\n")
    assert again.stderr.splitlines() == [
        f"warning: {path} ends early (the run was stopped): drawn up to round 2",
        f"warning: {picture} was there and is replaced",
    ]


def test_missing_robot_and_missing_round_are_different(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = make_record(tmp_path / "run.mcap", n=3, rounds=4, llm=False)
    for argv, text in (
        (("--robot", 44), "--robot 44: there are robots 0 to 2"),
        (("--round", 99), "--round 99: there are rounds 0 to 4"),
        (("--robot", 1), "no model was asked by robot 1 in this run"),
    ):
        error = call("inspect", path, *argv, monkeypatch=monkeypatch).exception
        assert isinstance(error, InputError) and str(error).startswith(text), str(error)


def test_a_flight_asks_for_its_drones_before_the_last_question(monkeypatch: pytest.MonkeyPatch) -> None:
    result = call("fly", monkeypatch=monkeypatch)
    assert isinstance(result.exception, InputError) and "--config FILE" in str(result.exception)
    assert "Type 'fly'" not in result.stdout


def test_the_viewer_shows_no_address_before_all_is_known_to_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for model, text in (
        ("simulated:ideal", "--model simulated:ideal: expected a language model"),
        (f"local:{tmp_path}/none.gguf", "--model "),
    ):
        result = call("view", "--no-browser", "--port", 0, "--model", model, monkeypatch=monkeypatch)
        assert isinstance(result.exception, InputError) and str(result.exception).startswith(text)
        assert "http" not in result.stdout
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    result = call("view", "--no-browser", "--port", 0, monkeypatch=monkeypatch)
    assert "pip install 'llm-flock[view]'" in str(result.exception) and "http" not in result.stdout


def test_described_missions_take_models_on_board(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("llm_flock_onboard._local.source.OnBoard.digests", lambda self, model: {})
    assert MissionReader("local:smollm2").model == "local:smollm2"


def test_a_sweep_is_shortened_from_the_command_line(tmp_path: Path) -> None:
    grid = 'loss = [0.0, 0.2]\nkind = [{ name = "plain" }, { name = "noisy", noise = 0.1 }]'
    small(tmp_path, seeds=5, grid=grid)
    path = next(tmp_path.glob("*.toml"))
    short = load_sweep(path, seeds=1, variables={"kind": ["noisy"], "loss": [0.2]})
    assert {t.cell for t in short.trials} == {
        "triangle/3 flock loss=0.2 kind=noisy",
        "triangle/3 baseline loss=0.2 kind=noisy",
    }
    assert len(short.trials) == 2 and {t.id for t in short.trials} < {t.id for t in load_sweep(path).trials}
    with pytest.raises(InputError, match=r"unknown value of axis kind; did you mean 'noisy'\?"):
        load_sweep(path, variables={"kind": ["nosy"]})


def test_compare_prints_a_table_or_markdown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr("llm_flock_lab._experiments.compare.compare", lambda cells, **options: ())
    argv = ("compare", "--cells", "triangle/3", "--protocols", "flock")
    assert call(*argv, monkeypatch=monkeypatch).stdout.startswith("┏")
    assert call(*argv, "--markdown", monkeypatch=monkeypatch).stdout.startswith("| protocol |")
    tex = call(*argv, "--latex", monkeypatch=monkeypatch).stdout
    assert tex.startswith("\\begin{tabular}{@{}llrrr") and "formed \\% {[}95 \\%{]} &" in tex
    assert "waypoints" not in tex, "no room for it on a page"
    monkeypatch.setenv("COLUMNS", "80")
    narrow = call(*argv, monkeypatch=monkeypatch).stdout
    assert narrow.count("┏") == 2 and max(map(len, narrow.splitlines())) <= 80


def test_version_names_the_installed_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    said = call("--version", monkeypatch=monkeypatch).output.splitlines()
    assert f"llm-flock {version('llm-flock')}" in said and f"llm-flock-view {version('llm-flock-view')}" in said


def test_geometry_is_not_called_a_help_for_models(monkeypatch: pytest.MonkeyPatch) -> None:
    alone = call("run", "--robots", 3, "--shape", "triangle", "--model", "geometry", monkeypatch=monkeypatch).output
    assert "by geometry without" in alone and "with help" not in alone
