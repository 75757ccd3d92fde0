"""Exports and live runs as a user meets them: a page in a real browser, a Rerun file, commands with Foxglove."""

from __future__ import annotations

import importlib
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import ENV, flock_process
from foxglove_client import FoxgloveClient
from playwright.sync_api import Browser, Page, expect
from sample_records import FakeRun, make_record, run_info

from llm_flock.record._reader import read_record
from llm_flock.record._schema import Entry, ProtocolEvent, RunInfo
from llm_flock.record._writer import RecordWriter
from llm_flock_swarm._network.swarm import free_port

HOSTILE = """</script><script>window.pwned=1</script>"><img src=x onerror="window.pwned=2">"""


class Poisoned:
    """A sink that puts hostile text wherever a record has room for text."""

    def __init__(self, writer: RecordWriter) -> None:
        self._writer = writer

    def write(self, entry: Entry) -> None:
        if isinstance(entry, RunInfo):
            names = {"consensus": HOSTILE, "assignment": HOSTILE}
            entry = run_info(config={"model": {"model": HOSTILE}, "protocol": names})
        if isinstance(entry, ProtocolEvent):
            entry = entry.model_copy(update={"kind": HOSTILE, "detail": {"reason": HOSTILE}})
        self._writer.write(entry)


@contextmanager
def opened(browser: Browser, path: Path, said: list[str], asked: list[str]) -> Iterator[Page]:
    page = browser.new_page(viewport={"width": 1100, "height": 700}, reduced_motion="reduce")
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(path.as_uri())
    page.locator("canvas[data-round]").wait_for()
    yield page
    page.close()


def test_the_page_plays_steps_and_scrubs_without_any_request(browser: Browser, tmp_path: Path) -> None:
    make_record(tmp_path / "run.mcap", n=6, rounds=12)
    flock_process("export", "run.mcap", "--html", cwd=tmp_path)
    said, asked = list[str](), list[str]()
    with opened(browser, tmp_path / "replay.html", said, asked) as page:
        where = page.locator(".flock-where")
        expect(where).to_have_text("round 0 of 12")
        page.get_by_label("One round on").click()
        expect(where).to_have_text("round 1 of 12")
        page.get_by_role("tab", name="Events").click()
        expect(page.locator(".flock-event").first).to_contain_text("Robot 0")
        expect(page.locator(".flock-headline")).to_have_text("Formed in round 12")
        timeline = page.locator(".flock-time canvas")
        box = timeline.bounding_box()
        assert box is not None
        page.mouse.click(box["x"] + 72 + (box["width"] - 86) / 2, box["y"] + box["height"] - 8)
        expect(where).to_have_text("round 6 of 12")
        expect(page).to_have_url(f"{(tmp_path / 'replay.html').as_uri()}#round=6&tab=events")
        page.get_by_label("Find in all rounds").fill("robot 2")
        expect(page.locator(".flock-event")).to_have_count(12)
        page.evaluate("location.hash = '#round=9&robots=3&tab=plots'")
        expect(where).to_have_text("round 9 of 12")
        page.evaluate("location.hash = '#round=6&robots=3&tab=events'")
        expect(where).to_have_text("round 6 of 12")
        page.get_by_label("Rounds a second").select_option("30")
        page.get_by_label("Play the picture").click()
        expect(where).to_have_text("round 12 of 12")
        assert page.locator("main .flock-arena canvas").get_attribute("data-round") == "12"
    assert not said and asked == [(tmp_path / "replay.html").as_uri()]


def test_hostile_text_in_a_record_runs_nothing(browser: Browser, tmp_path: Path) -> None:
    folder = tmp_path / "<b>bold"
    with RecordWriter(folder / "run.mcap") as writer:
        FakeRun(n=3, rounds=2).write(Poisoned(writer))
    flock_process("export", str(folder), "--html", cwd=tmp_path)
    said, asked = list[str](), list[str]()
    with opened(browser, folder / "replay.html", said, asked) as page:
        page.get_by_label("One round on").click()
        expect(page.locator(".flock-what").first).to_contain_text("<script>window.pwned=1")
        assert page.evaluate("window.pwned") is None and page.locator("img, b").count() == 0
        refused = page.evaluate("fetch('https://example.org').then(() => 'sent', () => 'refused')")
        assert refused == "refused"
    assert len(asked) == 1


def test_a_record_opens_in_rerun(tmp_path: Path) -> None:
    rerun = shutil.which("rerun", path=str(Path(sys.executable).parent))
    if rerun is None:
        pytest.skip("rerun-sdk is not installed")
    record = read_record(make_record(tmp_path / "run.mcap", n=4, rounds=5, dim=3))
    flock_process("export", "run.mcap", "--rerun", cwd=tmp_path)
    check = subprocess.run(
        [rerun, "rrd", "verify", "run.rrd"], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
    )
    assert check.returncode == 0, check.stderr
    chunk: Any = importlib.import_module("rerun.chunk")
    batches = [
        one.to_record_batch()
        for one in chunk.RrdReader(str(tmp_path / "run.rrd")).stream().to_chunks()
        if str(one.entity_path).strip("/") == "world/robots"
    ]
    seen = {
        number: places
        for batch in batches
        for number, places in zip(
            batch.column("round").cast("int64").to_pylist(), batch.column("Points3D:positions").to_pylist(), strict=True
        )
    }
    assert sorted(seen) == list(range(record.rounds + 1))
    for number, places in seen.items():
        assert np.array(places) == pytest.approx(record.positions[number], abs=1e-4)


@contextmanager
def served(folder: Path, *arguments: str) -> Iterator[str]:
    """The address at which a command serves Foxglove, until it is interrupted."""
    command = [sys.executable, "-m", "llm_flock", *arguments, "--foxglove", "--foxglove-port", "0"]
    with subprocess.Popen(command, cwd=folder, env=ENV, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        try:
            lines = iter(process.stderr.readline, "")
            yield next(found[0] for line in lines if (found := re.search(r"ws://\S+", line)))
        finally:
            process.send_signal(signal.SIGINT)
            process.stderr.read()
            process.wait(30)


def test_foxglove_client_gets_a_run(tmp_path: Path) -> None:
    options = ("--robots", "5", "--rounds", "200", "--no-stop-when-formed", "--quiet", "--pace", "20", "--out", "demo")
    with served(tmp_path, "run", *options) as url, FoxgloveClient(url) as client:
        client.subscribe("/state", "/robots/4/pose")
        client.listen_until(lambda: len(client.of("/robots/4/pose")) > 3 and len(client.of("/state")) > 3)
    assert read_record(tmp_path / "demo" / "run.mcap").rounds >= 3


def test_foxglove_client_gets_a_swarm_and_its_new_mission(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    options = ("--robots", "4", "--quiet", "--no-record", "--no-stop-when-formed", "--connect", endpoint)
    with served(tmp_path, "swarm", *options) as url, FoxgloveClient(url) as client:
        client.subscribe("/mission", "/state")
        client.listen_until(lambda: bool(client.of("/state")))
        flock_process("mission", "--set", "shape=line", "--connect", endpoint, cwd=tmp_path)
        client.listen_until(lambda: client.of("/mission")[-1]["mission"]["shape"] == "line")


def test_the_viewer_plays_a_record_to_foxglove(tmp_path: Path) -> None:
    make_record(tmp_path / "run.mcap", n=4, rounds=3)
    with served(tmp_path, "view", "run.mcap", "--no-browser", "--port", "0") as url, FoxgloveClient(url) as client:
        client.subscribe("/state")
        client.listen_until(lambda: [state["round"] for state in client.of("/state")][-2:] == [2, 3])
