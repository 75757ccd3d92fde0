"""Hostile words in every text of a record, a result and a row stay words in a real browser, on every page."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import quote

import msgspec
import pytest
from hostile_words import WORDS, hostile
from playwright.sync_api import Browser, Page
from pydantic import ValidationError
from sample_records import FakeRun
from sample_results import trial
from viewer_pages import at, go, ready, viewer

from llm_flock.record._schema import Entry, LlmEntry, MissionInfo, PlanInfo, ProtocolEvent, State
from llm_flock.record._writer import RecordWriter
from llm_flock_lab._exam.leaderboard import page_text
from llm_flock_lab._exam.rows import Row, read_rows
from llm_flock_lab._experiments.tables import build_tables
from llm_flock_lab._experiments.trial import TrialResult
from llm_flock_view._viewer import events

DETAILS = set(re.findall(r'detail(?:\.get\(|\[)"(\w+)"', inspect.getsource(events)))


class Hostile:
    """Writes entries with hostile words in every text."""

    def __init__(self, writer: RecordWriter) -> None:
        self.writer = writer

    def write(self, entry: Entry) -> None:
        old = entry.model_dump(mode="json")
        new: dict[str, Any] = hostile(type(entry), old)
        if isinstance(entry, PlanInfo):
            new["plan_id"] = WORDS + old["plan_id"]
        if isinstance(entry, State):
            new["plan_ids"] = [one and WORDS + one for one in old["plan_ids"]]
        if isinstance(entry, MissionInfo):
            new["mission"][WORDS] = WORDS
        if isinstance(entry, LlmEntry) and entry.robot:
            new |= dict.fromkeys(("error", "rejected")[: 2 - entry.robot % 2])
            new |= {"kind": old["kind"]}
        self.writer.write(type(entry).model_validate(new))

    def tell(self, number: int) -> None:
        """An event of every kind that the pages know, each with every detail that they name."""
        known = {"slot": 1, "from": 1, "before": 1, "wait": 1, "refusals": 1, "robot": 1}
        lists = {name: [WORDS] for name in ("proposed", "flown", "vacant", "slots", "missing")}
        for kind in (*sorted({*events._SENTENCES, *events._PLAN_SENTENCES, *events._TRACKS, *events._FLIGHT}), WORDS):
            detail = {**dict.fromkeys(DETAILS, WORDS), **known, **lists, WORDS: WORDS}
            self.writer.write(ProtocolEvent(round=number, comm_round=0, robot=0, kind=kind, detail=detail))


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A record in a folder whose name is hostile as well."""
    name = "<img src=x onerror=broken=12>\u202e' \" onclick=broken=13 `${broken=14}`"
    path = tmp_path_factory.mktemp("hostile") / name / "run.mcap"
    with RecordWriter(path) as writer:
        sink = Hostile(writer)
        FakeRun(n=3, rounds=2).write(sink, finish=False)
        sink.tell(2)
        FakeRun(n=3, rounds=2).write_round(sink, 3)
    return path


@contextmanager
def watched(browser: Browser, url: str) -> Iterator[Page]:
    """A page on which nothing may run, and which may ask nobody else."""
    context = browser.new_context(viewport={"width": 1280, "height": 720}, reduced_motion="reduce")
    page = context.new_page()
    asked: list[str] = []
    said: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.on("dialog", lambda dialog: said.append(dialog.message))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("console", lambda message: said.append(message.text))
    go(page, url)
    yield page
    unharmed(page)
    own = re.escape(url.split("/")[2])
    assert [one for one in asked if not re.match(rf"http://{own}/|file:|data:|blob:", one)] == []
    assert said == [], said
    context.close()


def unharmed(page: Page) -> None:
    assert page.evaluate("window.broken") is None
    found = page.evaluate(
        """() => [...document.querySelectorAll("*")].filter((one) =>
            ["xss-mark", "iframe", "base"].includes(one.localName) ||
            [...one.attributes].some((a) => a.name.startsWith("on") || /^\\s*javascript:/i.test(a.value))
        ).map((one) => one.outerHTML.slice(0, 200))"""
    )
    assert found == []
    assert not set("\u202e\u2028\x1b") & set(page.title() + page.locator("body").inner_text())


def test_viewer(record: Path, browser: Browser) -> None:
    with viewer(record.parents[1], record.parent.name) as url, watched(browser, url) as page:
        ready(page)
        for _ in range(2):
            page.keyboard.press("ArrowRight")
            for robot in range(3):
                page.get_by_label("Robot", exact=True).select_option(f"0:{robot}")
                mind = page.locator(".flock-mind").first
                mind.get_by_text(f"Robot {robot} ·").first.wait_for()
                for prompt in mind.get_by_text(re.compile(r"^Prompt")).all():
                    prompt.click()
                unharmed(page)
            page.get_by_role("tab", name="Events").click()
            unharmed(page)
        go(page, at(url, "runs"))
        page.get_by_label("Compare ").check()
        unharmed(page)


def test_forms_and_addresses(record: Path, browser: Browser) -> None:
    with viewer(record.parents[1], record.parent.name) as url, watched(browser, url) as page:
        for path in ("cockpit", "runs", f"?{quote(WORDS)}", f"#{quote(WORDS)}"):
            page.goto(url.partition("?")[0] + path)
            for box in page.locator("input[type=text], input[list], textarea").all():
                if box.is_visible() and box.is_enabled():
                    box.fill(WORDS)
                    box.press("Enter")
            page.wait_for_timeout(300)
            unharmed(page)


def test_exported_page(record: Path, browser: Browser, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "llm_flock", "export", "--html", str(record), "--out", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True)
    (path,) = tmp_path.glob("*.html")
    with watched(browser, path.as_uri()) as page:
        ready(page)
        page.keyboard.press("End")
        unharmed(page)


def test_report(record: Path, browser: Browser, tmp_path: Path) -> None:
    results = tmp_path / WORDS[40:90].replace("/", "")
    (results / "trials").mkdir(parents=True)
    (results / "records").mkdir()
    old = msgspec.to_builtins(trial("circle", 10, "paper", 0))
    new = hostile(TrialResult, old)
    new |= {"id": "t0", "error": WORDS, "config": old["config"], "record": "records/t0.mcap"}
    new["config"]["model"]["model"] = WORDS
    (results / "trials" / "t0.json").write_bytes(msgspec.json.encode(new))
    (results / "records" / "t0.mcap").write_bytes(record.read_bytes())
    build_tables(results)
    command = [sys.executable, "-m", "llm_flock", "report", str(results), "--out", str(tmp_path / "out"), "-q"]
    subprocess.run([*command, "--formats", "png", "--gallery", "1", "--no-fly-again"], check=True)
    path = tmp_path / "out" / "report.html"
    assert "&lt;xss-mark" in path.read_text(encoding="utf-8")
    with watched(browser, path.as_uri()) as page:
        for details in page.locator("summary").all():
            details.click()
        page.get_by_role("button", name="Light or dark").click()
        unharmed(page)


def test_leaderboard(browser: Browser, tmp_path: Path) -> None:
    """As Sphinx and GitHub show it, which read Markdown with HTML in it."""
    markdown = pytest.importorskip("markdown_it").MarkdownIt("commonmark").enable("table")
    old = read_rows(Path(__file__).parents[2] / "docs" / "leaderboard")[0].model_dump(mode="json")
    row = Row.model_validate(old)
    for name, field in Row.model_fields.items():
        told = hostile(field.annotation, old.get(name) or {})
        with suppress(ValidationError):  # what the type refuses is on no page
            row = Row.model_validate({**row.model_dump(mode="json"), name: told})
    longest = row.model_copy(update={"model": "m" * 990 + WORDS, "simulated": not row.simulated})
    path = tmp_path / "page.html"
    path.write_text(markdown.render(page_text([row, longest])), encoding="utf-8")
    assert "xss-mark" in path.read_text(encoding="utf-8")
    with watched(browser, path.as_uri()) as page:
        assert page.locator("table a").count() == 0
