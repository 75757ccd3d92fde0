"""What the terminal shows: words of the operator and of models are shown as they are, never read as markup."""

from __future__ import annotations

import ast
import io
import logging
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from sample_records import llm_entry, make_record

from llm_flock.cli import _terminal as terminal
from llm_flock.cli._display import live_line, show_conversation, show_overview
from llm_flock.cli._terminal import Screen, say
from llm_flock.errors import InputError, RecordError
from llm_flock.mission import Mission
from llm_flock.printable import CleanFormatter, printable
from llm_flock.record._reader import RunRecord, read_record
from llm_flock.record._schema import ChatLine, ProtocolEvent
from llm_flock.runtime._trial import TrialProgress
from llm_flock_swarm._cli.accusations import show_accusations

AWKWARD = ["text:{x}", "text:[/]foo", "text:{task.fields[label]} [bold", "text:a\\"]


@pytest.fixture
def record(tmp_path: Path) -> RunRecord:
    return read_record(make_record(tmp_path / "run.mcap", n=3, rounds=1))


@pytest.mark.parametrize("shape", AWKWARD)
def test_the_live_line_shows_any_label_on_a_terminal(
    shape: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "200")
    now = TrialProgress(
        round=2,
        rounds=60,
        n_robots=3,
        at_goal=1,
        plans_in_use=1,
        distinct_goals=3,
        error=None,
        model_calls=9,
        tokens=100,
        cost_usd=None,
    )
    bar, show = live_line(shape, enabled=True)
    with bar:
        show(now)
    assert shape in capsys.readouterr().err


@pytest.mark.parametrize("shape", AWKWARD)
def test_the_overview_shows_any_shape(
    record: RunRecord, shape: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    mission = record.mission.model_copy(update={"mission": {**record.mission.mission, "shape": shape}})
    show_overview(replace(record, missions=(mission,)))
    assert f"{shape}, 3 robots" in capsys.readouterr().out


def test_a_conversation_shows_any_model(
    record: RunRecord, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    show_conversation(replace(record, llm=(llm_entry(1, 0, model="openai:[/]x"),)), 0, None)
    assert capsys.readouterr().out.count("openai:[/]x") == 3


HOSTILE = "\x1b]8;;http://bad.example\x1b\\here\x1b[2J\x9b31m\u202egnp\u2066\r\x00\U000e0041"


def shown(text: str) -> bool:
    """Whether nothing but text was written."""
    return all(letter == "\n" or letter.isprintable() for letter in text)


def test_nothing_in_a_record_drives_the_terminal(
    record: RunRecord, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    call = llm_entry(1, robot=0).model_copy(
        update={
            "model": HOSTILE,
            "text": HOSTILE,
            "rejected": HOSTILE,
            "faults": [HOSTILE],
            "messages": [ChatLine(role=HOSTILE, text=HOSTILE)],
        }
    )
    mission = record.mission.model_copy(update={"mission": {**record.mission.mission, "shape": HOSTILE}})
    detail = {"robot": 1, "reason": HOSTILE, "proof": HOSTILE}
    event = ProtocolEvent(round=0, comm_round=None, robot=0, kind="accused", detail=detail)
    result = {"plan_robot": 1, "plan_by": HOSTILE}
    hostile = replace(record, llm=(call,), missions=(mission,), events=(event,), result=result)
    show_overview(hostile)
    show_accusations(hostile, keys=None)
    show_conversation(hostile, 0, None)
    out = capsys.readouterr().out
    assert shown(out) and "here" in out and "\\x1b[2J" in out


def test_errors_logs_and_paths_are_cleaned(capsys: pytest.CaptureFixture[str]) -> None:
    say(f"error: {HOSTILE}", error=True)
    say(Path(HOSTILE.replace("\x00", "")))
    said = capsys.readouterr()
    assert shown(said.out) and shown(said.err) and "\\u202e" in said.err
    log = logging.LogRecord("x", logging.WARNING, "", 1, "%s", (HOSTILE,), None)
    assert shown(CleanFormatter("%(message)s").format(log))


def test_colours_of_our_own_stay_and_ordinary_text_is_unchanged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    file = io.StringIO()
    Screen(file=file, force_terminal=True, color_system="standard").print("[bold red]no[/]")
    assert "\x1b[1;31mno" in file.getvalue()
    for text in ("Grüße, 編隊\n\tαβγ", "👩\u200d🚀", "می\u200cخواهم"):
        assert printable(text) == text


def test_the_command_line_writes_through_one_door() -> None:
    """Who prints past `terminal` prints uncleaned."""
    for path in Path(terminal.__file__).parent.glob("*.py"):
        calls = [
            node.func.id
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        ]
        assert path.name == "_terminal.py" or not {"print", "Console"} & set(calls), path.name


@pytest.mark.parametrize("letter", ["\x1b", "\n", "\t", "\x85", "\u202e", "\u2028", "\u200b", "\ud800"])
def test_described_shape_with_hidden_letters_is_rejected(letter: str) -> None:
    with pytest.raises(InputError, match="visible letters only") as caught:
        Mission(shape=f"text:a heart{letter}", n_robots=4)
    assert caught.value.field == "shape"
    assert Mission(shape="text:ein Herz für João", n_robots=4).shape.endswith("João")


FORGED = "x\nerror: forged"


def test_nothing_in_a_record_begins_a_line(
    record: RunRecord, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    mission = record.mission.model_copy(update={"mission": {**record.mission.mission, "shape": FORGED}})
    calls = (llm_entry(1, 0, rejected=FORGED, faults=[FORGED]), llm_entry(1, 0, error=FORGED))
    forged = replace(record, missions=(mission,), llm=calls, result={"plan_robot": 1, "plan_by": FORGED})
    show_overview(forged)
    show_conversation(forged, 0, None)
    for error in (InputError(FORGED, "x", FORGED), RecordError(FORGED)):
        say(error)
    out = capsys.readouterr().out
    assert "\\nerror: forged" in out and "\nerror: forged" not in out


def test_a_huge_message_is_cut(record: RunRecord, capsys: pytest.CaptureFixture[str]) -> None:
    show_conversation(replace(record, llm=(llm_entry(1, 0, text="[" * 2_000_000),)), 0, None)
    out = capsys.readouterr().out
    assert "and 1,900,000 more characters" in out and len(out) < 1_000_000


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no full device here")
@pytest.mark.parametrize("line", ["models", "--help"])
def test_a_full_disk_is_one_line(line: str) -> None:
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "llm_flock", line]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (1, "error: nothing more can be written (No space left on device)\n")
