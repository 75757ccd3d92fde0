"""What the terminal shows: words of the operator and of models are shown as they are, never read as markup."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from sample_records import llm_entry, make_record

from llm_flock.cli.display import live_line, show_conversation, show_overview
from llm_flock.record.reader import RunRecord, read_record
from llm_flock.runtime.trial import TrialProgress

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
