"""What a page may ask for, and what a model's reading of plain words is checked for."""

from __future__ import annotations

import asyncio
import json
import time
from pathlib import Path
from typing import Any

import pytest

from llm_flock.errors import InputError
from llm_flock.llm import MissionReader
from llm_flock.runtime._config import RunConfig
from llm_flock_view._viewer import launcher
from llm_flock_view._viewer.form import options
from llm_flock_view._viewer.launcher import Launcher
from llm_flock_view._viewer.library import Library
from llm_flock_view._viewer.orders import PageOrders
from llm_flock_view._viewer.steered_run import FIELDS, config_of


def test_a_form_is_checked_as_the_command_line_checks_it() -> None:
    config = config_of({"shape": "cross", "n_robots": 5, "protocol": "paper", "model": "simulated:ideal", "seed": None})
    assert (config.mission.shape, config.protocol.consensus) == ("cross", "influence")
    with pytest.raises(InputError, match="n_robots = 0: expected at least 1"):
        config_of({"n_robots": 0})
    with pytest.raises(InputError, match="expected one of ideal"):
        config_of({"model": "simulated:nonsense"})
    with pytest.raises(InputError, match="n_robots"):
        config_of({"n_robots": 2000, "start": "separated"})


def test_what_becomes_of_gaps_is_a_choice_of_the_form(tmp_path: Path) -> None:
    offered = [name for name, _ in options(Launcher(Library(), tmp_path))["gaps"]]
    assert [config_of({"gaps": name}).protocol.gaps for name in offered] == ["report", "replan"]
    with pytest.raises(InputError, match="expected one of report, replan"):
        config_of({"gaps": "fill"})


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("out", "/tmp/elsewhere"),
        ("prompts", "/etc"),
        ("record_llm", "/tmp/x"),
        ("base_url", "http://elsewhere.invalid"),
        ("consensus", "os:system"),
        ("shape", "points:/etc/passwd"),
        ("shape", "  points:/etc/passwd"),
        ("model", "replay:/etc/passwd"),
        ("model", "openai:gpt-5"),
        ("model", "local:/etc/passwd"),
        ("model", "local:smollm2+/etc/passwd.gguf"),
        ("model", "0=simulated:ideal,1=openai:gpt-5"),
        ("start_positions", [[0, 0]]),
    ],
)
def test_a_page_reaches_no_file_no_module_and_no_other_address(field: str, value: object) -> None:
    with pytest.raises(InputError, match=field):
        config_of({field: value})


def asked(tmp_path: Path, **fields: object) -> dict[str, Any]:
    library = Library()
    orders = PageOrders(library, Launcher(library, tmp_path))
    given = {"shape": "circle", "n_robots": 10, "center": [50, 50], "model": "simulated:ideal", "rounds": 1}
    return asyncio.run(orders.carry_out({"order": "start", "pace": 100, "fields": {**given, **fields}}))


@pytest.mark.parametrize(
    "center", ["abc", "50 50", [50], [50, 50, 50], [50, "x"], [True, 1], [float("nan"), 1], [10**400, 1], {"x": 1}]
)
def test_a_centre_is_asked_for_in_the_words_of_the_form(tmp_path: Path, center: object) -> None:
    assert asked(tmp_path, center=center) == {"error": "Two numbers, such as 50, 50", "field": "center"}


def test_errors_name_what_the_form_has(tmp_path: Path) -> None:
    found = asked(tmp_path, center=[5, 5])
    assert found["field"] == "center"
    assert found["error"].startswith(
        "The formation reaches beyond the walls of the arena: expected at least 16.18 units"
    )
    assert asked(tmp_path, spacing=1) == {"error": "Expected at least the safe distance, 3", "field": "spacing"}


def test_models_that_the_operator_named_may_be_asked() -> None:
    assert config_of({"model": "openai:gpt-5"}, ["openai:gpt-5"]).model.model == "openai:gpt-5"


def test_the_packaged_model_on_board_may_be_asked() -> None:
    pytest.importorskip("xllamacpp")
    assert config_of({"model": "local:smollm2+none"}).model.model == "local:smollm2+none"


def test_fields_of_the_page_are_fields_of_the_configuration() -> None:
    known = {name for section in RunConfig.model_fields.values() for name in section.annotation.model_fields}  # pyright: ignore[reportOptionalMemberAccess, reportAttributeAccessIssue]
    assert set(FIELDS) <= known


def test_starts_are_shown_before_a_run_and_can_be_moved(tmp_path: Path) -> None:
    library = Library()
    orders = PageOrders(library, Launcher(library, tmp_path))
    fields = {"shape": "square", "n_robots": 4, "center": [40, 60], "model": "geometry", "rounds": 1}
    shown = asyncio.run(orders.carry_out({"order": "preview", "fields": fields}))
    assert shown["center"] == (40.0, 60.0) and len(shown["starts"]) == len(shown["places"]) == 4
    moved = [[10.0, 10.0], *shown["starts"][1:]]
    again = asyncio.run(orders.carry_out({"order": "preview", "fields": {**fields, "start_positions": moved}}))
    assert again["starts"] == moved and not library.runs, "nothing flies"
    for wrong in ([[500.0, 0.0], *moved[1:]], moved[:3]):
        order = {"order": "start", "pace": 1.0, "fields": {**fields, "start_positions": wrong}}
        said = asyncio.run(orders.carry_out(order))
        assert said["field"] == "start_positions" and not library.runs


def test_what_a_reader_made_of_words_flies_once_confirmed(tmp_path: Path) -> None:
    part = {"shape": "square", "center": [40, 60], "spacing": 8}
    table = {"a square": {"answer": "mission", "robots": 8, "stages": [{"parts": [part]}]}, "again": 3}
    (tmp_path / "table.json").write_text(json.dumps(table), encoding="utf-8")
    reader = MissionReader(f"simulated:reader:{tmp_path / 'table.json'}")
    started_by = Launcher(Library(), tmp_path / "runs", reader=reader)
    orders = PageOrders(started_by.library, started_by)

    def said(**asked: object) -> dict[str, Any]:
        return asyncio.run(orders.carry_out(asked))

    found = said(order="read", words="a square")
    assert found["in_words"].startswith("simulated: 8 robots · a square around 40, 60, neighbours 8 apart")
    assert "refused" in said(order="read", words="a circle")["error"].casefold()
    assert "not of the form" in said(order="read", words="again")["error"]
    assert "no longer known" in said(order="start", draft="x", pace=100, fields={})["error"]
    assert "takes no orders" in said(order="read", words="a square", runs=["x"])["error"]
    started = said(order="start", draft=found["draft"], pace=100, fields={"shape": "line", "model": "geometry"})
    (run,) = started_by.runs.values()
    assert started["address"] and (run.config.mission.shape, run.config.mission.n_robots) == ("square", 8)
    deadline = time.monotonic() + 60
    while not run.over and time.monotonic() < deadline:
        time.sleep(0.05)
    assert run.over


def test_words_and_stages_steer_a_run_in_flight(tmp_path: Path) -> None:
    line = {
        "answer": "mission",
        "stages": [{"parts": [{"shape": "line"}]}, {"parts": [{"shape": "wedge"}], "when": "order"}],
    }
    zone = {**line, "keep_out": [{"center": [9, 9], "radius": 2}]}
    wide = {"draw": [{"shape": "wedge", "scale": [2, 1]}]}
    table = {"a line, and a wedge when I say so": line, "a zone": zone, "wider": wide}
    (tmp_path / "table.json").write_text(json.dumps(table), encoding="utf-8")
    reader = MissionReader(f"simulated:reader:{tmp_path / 'table.json'}")
    started_by = Launcher(Library(), tmp_path / "runs", reader=reader)
    orders = PageOrders(started_by.library, started_by)
    fields = {"n_robots": 5, "rounds": 2000, "model": "geometry", "stop_when_formed": False}
    asyncio.run(orders.carry_out({"order": "start", "pace": 100, "fields": fields}))
    ((key, run),) = started_by.runs.items()

    def said(**asked: object) -> dict[str, Any]:
        return asyncio.run(orders.carry_out({"runs": [key], **asked}))

    def waits_for(shape: str) -> None:
        deadline = time.monotonic() + 60
        while run.orders.mission.shape != shape and time.monotonic() < deadline:
            time.sleep(0.02)
        assert run.orders.mission.shape == shape

    try:
        refused = said(order="read", words="a zone")["error"]
        assert "belongs to the robots, and is set before they start: no order in flight" in refused
        draft = said(order="read", words="a line, and a wedge when I say so")
        assert "(2) on your order: a wedge" in draft["in_words"]
        assert "has the mission" in said(order="change", draft=draft["draft"])["done"]
        waits_for("line")
        assert "has the mission" in said(order="proceed")["done"]
        waits_for("wedge")
        assert "no stage of the mission is left" in said(order="proceed")["error"]
        draft = said(order="read", words="wider", edit=True)
        assert "scale [2.0, 1.0]" in draft["in_words"]
        said(order="change", draft=draft["draft"])
        waits_for('program:{"draw":[{"scale":[2,1],"shape":"wedge"}]}')
    finally:
        said(order="end")
    deadline = time.monotonic() + 60
    while not run.over and time.monotonic() < deadline:
        time.sleep(0.05)
    assert run.over


def test_a_stand_in_cannot_read() -> None:
    with pytest.raises(InputError, match="cannot read"):
        MissionReader("simulated:ideal")


def test_the_first_run_finds_the_simulation_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    began: list[tuple[float, object]] = []

    class Timer:
        def __init__(self, after: float, act: object) -> None:
            began.append((after, act))

        def start(self) -> None:
            pass

    monkeypatch.setattr(launcher.threading, "Timer", Timer)
    one = Launcher(Library(), tmp_path)
    one.warm()
    one.warm()
    assert began == [(launcher.WARM_AFTER_S, launcher.fly_nothing)], "once"
    launcher.fly_nothing()
    assert not list(tmp_path.iterdir()), "nothing is recorded"


def test_the_name_of_a_wrong_field_can_be_sent_back(tmp_path: Path) -> None:
    answer = asked(tmp_path, **{"\ud800": 1})
    assert "error" in answer
    json.dumps(answer, ensure_ascii=False).encode()
