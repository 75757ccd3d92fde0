"""Errors name what the user typed: flags where a flag was typed, whole sentences, and similar names."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest
from typer.testing import CliRunner

from llm_flock.cli import app
from llm_flock.errors import FieldError, InputError, unknown
from llm_flock.runtime._config import RunConfig, build_config, load_config
from llm_flock_lab._experiments.sweep_file import load_sweep


def said(*argv: str, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr("sys.argv", ["llm-flock", *argv])
    error = CliRunner().invoke(app, argv).exception
    assert isinstance(error, InputError)
    return str(error)


@pytest.mark.parametrize(
    ("argv", "text"),
    [
        ("run --shape triangle --robots 10", "--robots 10: a triangle takes 3, 6, 9, 12, ... robots"),
        ("run --shape triangle", "--robots 10: a triangle takes 3, 6, 9, 12, ... robots"),
        ("run --shape circl", "--shape circl: unknown shape; did you mean 'circle'?"),
        ("run --model=opnai:gpt-5", "--model opnai:gpt-5: unknown provider 'opnai'; did you mean 'openai'?"),
        ("run --model simulated:idael", "--model simulated:idael: unknown profile 'idael'; did you mean 'ideal'?"),
        ("run --consensus provenence", "--consensus provenence: unknown rule; did you mean 'provenance'?"),
        ("run --protocol flok", "--protocol flok: unknown choice; did you mean 'flock'?"),
        ("run --center 50,nan", "--center 50,nan: expected a finite number"),
        ("run --reasoning-effort hgih", "--reasoning-effort hgih: unknown effort; did you mean 'high'?"),
        ("run --no-shield --robots 0", "--robots 0: expected at least 1"),
        ("compare --cells triangle/10", "--cells triangle/10: a triangle takes 3, 6, 9, 12, ... robots"),
        ("compare --cells nosuch/5 --fit-arena", "--cells nosuch/5: unknown shape"),
        ("run --pace nan", "--pace nan: expected a number from 0.01 to 1000"),
        ("run --shape points:nofile.csv", "--shape nofile.csv: expected a readable file"),
        ("run --shape points:", "--shape points:: expected points:FILE, with the name of a file"),
        ("compare --cells points:nofile.csv/3", "--cells points:nofile.csv/3: expected a readable file"),
        ("compare --cells points:nofile.csv/3 --fit-arena", "--cells points:nofile.csv/3: expected a readable file"),
        (
            "run --obstacles nofile.json",
            "--obstacles nofile.json: expected a JSON list, or the name of a file with one (No",
        ),
        ("run --pace 0", "--pace 0: expected a number from 0.01 to 1000"),
        (
            "ros2 --ros-namespace 1-b",
            "--ros-namespace 1-b: expected names with slashes between them, such as lab/flock",
        ),
        ("ros2 --swarm a/b", "--swarm a/b: expected 1 to 64 letters, digits, - and _"),
        ("fly --dry-run --no-shield", "--no-shield: has to be on in a flight, whatever the protocol"),
        ("compare --cells circle", "--cells circle: expected SHAPE/N with commas"),
        ("sweep none.toml", "none.toml: expected a file that can be read"),
        (
            'run --changes [{"round":3"robot":1}]',
            "--changes: broken JSON: Expecting ',' delimiter: line 1 column 12 (char 11)",
        ),
        ('run --changes [{"round":3', "--changes: broken JSON: Expecting ',' delimiter: line 1 column 12 (char 11)"),
        ('run --changes [{"round":3}]', "field 'robot' is missing in changes.0"),
        ('run --changes [{"round":0,"robot":1,"set":{}}]', "--changes, 0.round = 0: expected at least 1"),
    ],
)
def test_an_error_names_the_flag_that_was_typed(argv: str, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert said(*argv.split(), monkeypatch=monkeypatch).startswith(text)


@pytest.mark.parametrize(
    ("toml", "text"),
    [
        ("[mission]\nshap = 'circle'", "unknown field 'shap' in [mission]; did you mean 'shape'?"),
        ("[misson]\n", "unknown section [misson]; did you mean 'mission'?"),
        ("[mission]\nseed = 3", "field 'seed' belongs in [trial], not in [mission]"),
        ("shape = 'circle'", "field 'shape' belongs in [mission], below that line"),
        ("[mission]\nshape = 'triangle'", "n_robots = 10: a triangle takes 3, 6, 9, 12, ... robots"),
        ("[mission", "--config {}: this is not TOML: "),
        ("[mission]\ncenter = [1, 'x']", "center.1 = 'x': expected a number"),
        ("[protocol]\nshield = 'maybe'", "shield = 'maybe': expected true or false"),
    ],
)
def test_an_error_of_a_file_names_field_and_section(
    toml: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (path := tmp_path / "c.toml").write_text(toml)
    assert said("run", "--config", str(path), monkeypatch=monkeypatch).startswith(text.format(path))


@pytest.mark.parametrize(
    ("toml", "text"),
    [
        ("[sweep]\nseeds = 2\n[grid]", "field 'name' is missing in [sweep]"),
        ("[grid]\nshape = ['circle']", "section [sweep] is missing"),
        ("[sweep]\nname = 'a'\nseeds = 'x'\n[grid]", "seeds = 'x': expected a whole number"),
        ("[sweep]\nname = 'a'\nseed = 1\n[grid]", "field 'seeds' is missing in [sweep]"),
        ("[sweep]\nname = 'a'\nseeds = 1\n[grd]", "section [grid] is missing"),
        ("[sweep]\nname = 'a'\nseeds = 1\n[grid]\n[budgt]", "unknown section [budgt]; did you mean 'budget'?"),
        (
            "[sweep]\nname = 'a'\nseeds = 1\n[grid]\n[providers.opnai]",
            "unknown provider [providers.opnai]; did you mean 'openai'?",
        ),
        (
            "[sweep]\nname = 'a'\nseeds = 1\n[grid]\nteam = ['triangle/10']",
            "grid.team = 'triangle/10': a triangle takes 3, 6, 9, 12, ... robots",
        ),
        (
            "[sweep]\nname = 'a b'\nseeds = 1\n[grid]",
            "name = 'a b': expected letters, digits, '.', - and _, not only dots",
        ),
        ("[sweep]\nname = 'a'\nseeds = 1\n[grid]\nshap = ['x']", "unknown field 'shap'; did you mean 'shape'?"),
    ],
)
def test_an_error_of_a_sweep_names_field_and_section(toml: str, text: str, tmp_path: Path) -> None:
    (path := tmp_path / "s.toml").write_text(toml)
    with pytest.raises(InputError) as refused:
        load_sweep(path)
    assert str(refused.value) == text


def test_a_budget_of_a_sweep_is_not_that_of_a_trial(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (path := tmp_path / "s.toml").write_text("[sweep]\nname = 'a'\nseeds = 1\n[grid]\nteam = ['triangle/3']")
    text = said("sweep", str(path), "--dry-run", "--budget-cost", "nan", monkeypatch=monkeypatch)
    assert text == "--budget-cost nan: expected a finite number"
    path.write_text(path.read_text() + "\n[budget]\nmax_cost = -1")
    with pytest.raises(InputError, match=r"^max_cost = -1: expected more than 0"):
        load_sweep(path)


def test_python_sees_fields() -> None:
    with pytest.raises(InputError, match=r"^n_robots = 0: expected at least 1$"):
        build_config(n_robots=0)
    with pytest.raises(FieldError, match=r"^unknown field 'consensu'; did you mean 'consensus'\?$"):
        build_config(consensu="x")
    with pytest.raises(FieldError, match=r"^unknown field 'qqq'; `llm-flock run --help-all`"):
        build_config(qqq=1)


def test_names_that_are_near_none_are_listed() -> None:
    assert unknown("dog", "xyz", ["rex", "bello"]) == "unknown dog; expected one of rex, bello"
    assert unknown("dog", "xyz", []) == "unknown dog; expected one of (there are none)"


def test_errors_survive_a_worker_process() -> None:
    for error in (InputError("a", 1, "b"), InputError("a", None, says="is c"), FieldError("a", says="what d")):
        back = pickle.loads(pickle.dumps(error))
        assert (type(back), str(back), back.field, back.value, back.says) == (
            type(error),
            str(error),
            error.field,
            error.value,
            error.says,
        )


def test_every_section_is_known_to_the_errors(tmp_path: Path) -> None:
    for name in RunConfig.model_fields:
        (path := tmp_path / "c.toml").write_text(f"[{name}]\nzzqqzz = 1")
        with pytest.raises(FieldError, match=rf"^unknown field 'zzqqzz' in \[{name}\]; expected one of "):
            load_config(path)
