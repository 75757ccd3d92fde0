"""`llm-flock doctor`: what it finds, and that it shows no key."""

from __future__ import annotations

import json
import socket
import sys

import pytest
from integration.fault_server import running
from typer.testing import CliRunner

from llm_flock.cli import app
from llm_flock.cli._extensions import Finding
from llm_flock_flight._cli.fly import reach_drones
from llm_flock_swarm._cli.swarm import reach_router


def test_the_doctor_says_what_is_there_and_shows_no_key(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "a-secret")
    monkeypatch.delenv("DEEPSEEK_API_KEY", raising=False)
    monkeypatch.setitem(sys.modules, "cflib", None)
    with socket.create_server(("127.0.0.1", 0)) as server:
        endpoint = f"tcp/127.0.0.1:{server.getsockname()[1]}"
        result = CliRunner().invoke(app, ["doctor", "--json", "--router", endpoint])
    assert result.exit_code == 0 and "a-secret" not in result.output
    found = {(line["part"], line["name"]): line for line in json.loads(result.output)}
    assert found["key", "OPENAI_API_KEY"]["ok"] and not found["key", "DEEPSEEK_API_KEY"]["ok"]
    assert not found["extra", "crazyflie"]["ok"] and "crazyflie" in found["reach", "drone"]["detail"]
    assert found["reach", f"router at {endpoint}"]["ok"]
    assert not reach_router(router=endpoint)[0].ok and not reach_router(router="nowhere")[0].ok
    assert ("reach", "browser") in found


def test_the_doctor_asks_the_model_that_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cflib", None)  # its search leaves sockets open
    with running(fixed_answer="Position: [1.0, 2.0]", refuses="system") as server:
        asked = ["doctor", "--json", "--model", "openai-compatible:stand-in", "--base-url"]
        good = CliRunner().invoke(app, [*asked, server.base_url])
        bad = CliRunner().invoke(app, [*asked, server.base_url.removesuffix("/v1")])
    assert (good.exit_code, bad.exit_code) == (0, 1)
    last = json.loads(good.output)[-1]
    assert last["ok"] and "asked without roles" in last["detail"] and "Position" in last["detail"]
    assert "ends in /v1" in json.loads(bad.output)[-1]["detail"]
    with running(fixed_answer=" ") as server:
        silent = CliRunner().invoke(app, [*asked, server.base_url])
    assert silent.exit_code == 1 and not json.loads(silent.output)[-1]["ok"]


def test_the_doctor_finds_a_drone_or_says_why_not(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("cflib")
    from llm_flock_flight._crazyflie import link

    monkeypatch.setattr(link, "in_reach", lambda: ("udp://127.0.0.1:19850",))
    assert reach_drones()[0].ok

    def broken() -> tuple[str, ...]:
        raise OSError("no permission")

    monkeypatch.setattr(link, "in_reach", broken)
    assert reach_drones() == [Finding("reach", "drone", False, "the search failed: no permission")]


@pytest.mark.parametrize("columns", ["24", "60", "80"])
def test_no_name_is_cut(columns: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    text = CliRunner().invoke(app, ["doctor", "--no-drones"]).stdout
    assert "…" not in text and "OPENAI_COMPATIBLE_API_KEY" in text and "extra" in text
