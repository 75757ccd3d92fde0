"""The command line as a user meets it: real files, real signals, and real processes wherever those matter."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from command_line import ENV, Done, flock, flock_process

from llm_flock.record._reader import read_record
from llm_flock.runtime._result import Summary

ROOT = Path(__file__).parents[2]
DEMO = re.compile(r"^\t\$\(BIN\)/llm-flock ((?:run|figure|animate) .*runs/demo.*)$", re.MULTILINE)


def test_run_figure_animate_inspect(tmp_path: Path) -> None:
    run, figure, animate = DEMO.findall((ROOT / "Makefile").read_text(encoding="utf-8"))
    done = flock_process(*run.replace("runs/demo", "demo").split(), cwd=tmp_path)
    assert "simulated" in done.stdout and "yes, in round" in done.stdout
    assert flock(*figure.replace("runs/", "").split(), cwd=tmp_path).stdout.strip() == "demo/snapshots.png"
    written = ["demo/animation.gif", *(["demo/animation.mp4"] if shutil.which("ffmpeg") else [])]
    assert flock(*animate.replace("runs/", "").split(), cwd=tmp_path).stdout.split() == written
    assert (tmp_path / "demo/snapshots.png").stat().st_size > 20_000
    shown = ROOT / "docs/images/circle.gif"  # `python docs/gallery_images.py demo` draws it
    assert (tmp_path / "demo/animation.gif").read_bytes() == shown.read_bytes(), "the README shows another run"
    overview = flock("inspect", "demo/run.mcap", cwd=tmp_path).stdout
    assert "complete" in overview and "simulated" in overview
    talk = flock("inspect", "demo", "--robot", "3", "--round", "1", cwd=tmp_path).stdout
    assert "my plan" in talk and "Position:" in talk and "robot 3 · round 1" in talk


def test_json_prints_one_object_with_the_documented_keys(tmp_path: Path) -> None:
    done = flock("run", "--shape", "triangle", "--robots", "3", "--seed", "1", "--json", "--no-record", cwd=tmp_path)
    values = json.loads(done.stdout)
    assert set(values) == set(Summary.__dataclass_fields__)
    assert values["formed"] is True and values["record"] is None
    assert list(tmp_path.iterdir()) == []


def test_without_out_a_new_folder_is_made(tmp_path: Path) -> None:
    flock("run", "--shape", "line", "--robots", "2", "--rounds", "1", cwd=tmp_path)
    flock("run", "--shape", "line", "--robots", "2", "--rounds", "1", cwd=tmp_path)
    assert len(list((tmp_path / "runs").glob("*-line-2/run.mcap"))) == 2


def test_a_configuration_file_and_flags(tmp_path: Path) -> None:
    (tmp_path / "flock.toml").write_text('[mission]\nshape = "square"\nn_robots = 8\n[trial]\nrounds = 2\n')
    done = flock("run", "--config", "flock.toml", "--robots", "4", "--json", "--out", "x", cwd=tmp_path)
    assert json.loads(done.stdout)["n_robots"] == 4
    record = read_record(tmp_path / "x/run.mcap")
    assert record.run.config["mission"]["shape"] == "square"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--robots", "0"], "--robots 0: expected at least 1"),
        (["--spacing", "nan"], "--spacing nan: "),
        (["--spacing", "2"], "--spacing 2: "),
        (["--shape", "triangle", "--robots", "4"], "--robots 4: a triangle takes 3, 6"),
        (["--robots", "60"], "--arena 0,0,100,100: "),
        (["--comm-range", "9"], "--sense-range 9: "),
        (["--center", "a,b"], "--center a,b: "),
        (["--model", "openai:o3-mini"], "OPENAI_API_KEY"),
        (["--model", "nobody:x"], "--model nobody:x: unknown provider"),
        (["--config", "none.toml"], "--config none.toml: "),
        (["--consensus", "best"], "--consensus best: unknown rule"),
    ],
)
def test_wrong_input_is_one_line_exit_code_2_and_nothing_written(
    tmp_path: Path, arguments: list[str], words: str
) -> None:
    done = flock("run", *arguments, cwd=tmp_path, check=False)
    refused(done, words)
    assert list(tmp_path.iterdir()) == []


def refused(done: Done, words: str) -> None:
    assert done.returncode == 2
    assert done.stderr.startswith("error: ") and words in done.stderr and done.stderr.count("\n") == 1


def test_wrong_input_in_a_process_of_its_own(tmp_path: Path) -> None:
    refused(flock_process("run", "--robots", "0", cwd=tmp_path, check=False), "--robots 0: expected at least 1")


def test_provider_that_never_answers_ends_run_with_exit_code_1(tmp_path: Path) -> None:
    done = flock_process(
        "run", "--model", "simulated:flaky", "--max-tries", "1", "--out", "x", cwd=tmp_path, check=False
    )
    assert done.returncode == 1
    assert "no model answered" in done.stderr
    assert read_record(tmp_path / "x/run.mcap").complete


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_stopped_at_any_moment_the_record_is_readable(tmp_path: Path, sent: signal.Signals) -> None:
    command = [
        sys.executable,
        "-m",
        "llm_flock",
        "run",
        "--model",
        "simulated:slow@1.0",
        "--out",
        "x",
        "--rounds",
        "50",
    ]
    running = subprocess.Popen(
        [*command, "--json"] if sent is signal.SIGHUP else command,
        cwd=tmp_path,
        env=ENV,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    path = tmp_path / "x/run.mcap"
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        time.sleep(0.2)
        if path.exists() and path.stat().st_size > 100_000:
            break
    if sent is signal.SIGINT:
        assert "under way" in flock("inspect", "x", cwd=tmp_path).stdout
    running.send_signal(sent)
    shown, errors = running.communicate(timeout=30)
    record = read_record(path)
    assert len(record.states) >= 2
    assert record.complete
    told = json.loads(shown)["stopped"] == "interrupted" if sent is signal.SIGHUP else "interrupted in round" in shown
    assert running.returncode == 130 and "interrupted" in errors and told
    assert record.result is not None and record.result["stopped"] == "interrupted"
    assert record.result["model_calls"] == len(record.llm)


def test_lists_and_help(tmp_path: Path) -> None:
    assert "polygon" in flock("shapes", cwd=tmp_path).stdout
    assert "OPENAI_API_KEY" in flock("models", cwd=tmp_path).stdout
    text = flock("run", "--help", cwd=tmp_path).stdout
    for flag in (
        "--shape",
        "--robots",
        "--model",
        "--base-url",
        "--rounds",
        "--loss",
        "--seed",
        "--out",
        "--json",
        "--config",
    ):
        assert re.search(rf"{flag}\b", text), flag


def test_a_comparison_of_three_protocols(tmp_path: Path) -> None:
    for name, options in {
        "flock": [],
        "none": ["--consensus", "none"],
        "paper": ["--consensus", "influence", "--assignment", "nearest"],
    }.items():
        flock("run", "--seed", "7", "--rounds", "10", "--out", name, *options, cwd=tmp_path)
    flock("figure", "flock", "none", "paper", "--out", "three.png", cwd=tmp_path)
    assert (tmp_path / "three.png").stat().st_size > 20_000


def test_compare_prints_a_table_and_writes_a_line_a_trial(tmp_path: Path) -> None:
    arguments = ("--cells", "triangle/3,circle/60", "--protocols", "flock,baseline", "--fit-arena", "--rounds", "2")
    shown = ("--trials", "1", "--jobs", "2", "--out", "a.csv", "--markdown")
    done = flock("compare", *arguments, *shown, cwd=tmp_path)
    assert re.search(r"\| flock +\| circle +\| 60 +\| 0.0 \[", done.stdout)
    assert "simulated" in done.stdout and "baseline circle 60: 0 of 1 formed" in done.stderr
    assert len((tmp_path / "a.csv").read_text().splitlines()) == 1 + 4
    arguments = ("--cells", "triangle/3", *arguments[2:])
    again = flock("compare", *arguments, "--trials", "1", "--jobs", "1", "--json", "--quiet", cwd=tmp_path)
    rows = json.loads(again.stdout)
    assert again.stderr == "" and [(r["protocol"], r["n_robots"]) for r in rows] == [("flock", 3), ("baseline", 3)]
    assert list(tmp_path.iterdir()) == [tmp_path / "a.csv"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--cells", "circle"], "--cells circle: "),
        (["--cells", "circle/60"], "--arena 0,0,100,100: "),
        (["--protocols", "best"], "--protocols best: unknown protocol"),
        (["--model", "openai:o3-mini"], "OPENAI_API_KEY"),
    ],
)
def test_a_comparison_that_cannot_be_is_one_line(tmp_path: Path, arguments: list[str], words: str) -> None:
    done = flock("compare", "--trials", "1", "--jobs", "1", *arguments, cwd=tmp_path, check=False)
    refused(done, words)


def test_exit_code_reports_broken_trials(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "class Broken:\n  name = 'broken'\n  def choose(self, own, heard):\n    raise AttributeError('broken')\n"
    )
    env = {**ENV, "PYTHONPATH": os.pathsep.join([str(tmp_path), ENV.get("PYTHONPATH", "")])}
    command = ["compare", "--cells", "line/2", "--protocols", "flock", "--trials", "1", "--consensus", "mine:Broken"]
    done = subprocess.run(
        [sys.executable, "-m", "llm_flock", *command], cwd=tmp_path, env=env, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 1 and "rule 'broken' failed: AttributeError" in done.stdout


def gone(group: int) -> bool:
    """Whether a group of processes ends within five seconds."""
    for _ in range(50):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


def test_ctrl_c_ends_a_comparison_at_once_and_leaves_no_process(tmp_path: Path) -> None:
    running = subprocess.Popen(
        [sys.executable, "-m", "llm_flock", "compare", "--jobs", "2", "--trials", "500", "--out", "a.csv"],
        cwd=tmp_path,
        env=ENV,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    path = tmp_path / "a.csv"
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and not (path.exists() and path.read_text().count("\n") > 3):
        time.sleep(0.1)
    os.killpg(running.pid, signal.SIGINT)  # as a terminal does: to everybody in the group
    _, errors = running.communicate(timeout=10)
    assert running.returncode == 130
    assert errors == "interrupted; finished trials are in a.csv\n"
    assert path.read_text().count("\n") > 3
    assert gone(running.pid)


@pytest.mark.parametrize("command", ["inspect", "report", "run --prompts"])
def test_a_path_that_is_too_long_is_refused_in_one_line(command: str, tmp_path: Path) -> None:
    done = flock(*command.split(), "x" * 5_000, cwd=tmp_path, check=False)
    assert done.returncode == 2 and done.stderr.startswith("error: ") and "Traceback" not in done.stderr
