"""The viewer in a real browser: replay, live, scrub, conversation, cockpit, steering, and hostile words."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright
from sample_records import FakeRun, llm_entry, make_record

from llm_flock.record.schema import Entry, LlmEntry, ProtocolEvent, RunInfo, SummaryMessage
from llm_flock.record.writer import RecordWriter

HOSTILE = (
    "<script>window.broken = 1</script><img src=x onerror='window.broken = 2'> {{ 1 + 1 }} ${window.broken = 3} "
    "`${window.broken = 4}` </script><iframe src='https://elsewhere.invalid/'></iframe> [a](javascript:window.broken=5)"
)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.fail("no browser: install Debian's chromium (apt-get install chromium)", pytrace=False)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


@contextmanager
def viewer(folder: Path, *arguments: str) -> Iterator[str]:
    """A viewer as a user starts it; gives the address that it prints."""
    command = [sys.executable, "-m", "llm_flock", "view", *arguments, "--no-browser", "--port", "0"]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            url = process.stdout.readline().strip()
            assert url.startswith("http://"), process.stderr.read() if process.stderr else ""
            yield url
        finally:
            process.terminate()
            _, errors = process.communicate(timeout=20)
            assert "Traceback" not in errors, errors


@contextmanager
def page_at(browser: Browser, url: str, *, width: int = 1280, height: int = 720, dark: bool = False) -> Iterator[Page]:
    """A page that must neither complain nor ask anybody else."""
    context = browser.new_context(
        color_scheme="dark" if dark else "light", viewport={"width": width, "height": height}, accept_downloads=True
    )
    page = context.new_page()
    said: list[str] = []
    asked: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.on("websocket", lambda socket: asked.append(socket.url))
    page.goto(url)
    yield page
    own = re.escape(url.split("/")[2])
    assert said == []
    assert [address for address in asked if not re.match(rf"((http|ws)://{own}/|data:|blob:)", address)] == []
    context.close()


def shown_round(page: Page, arena: int = 0) -> int:
    return int(page.locator("#app .flock-arena canvas").nth(arena).get_attribute("data-round") or -1)


def until(true: Callable[[], bool], what: str, timeout_s: float = 20.0) -> None:
    end = time.monotonic() + timeout_s
    while not true():
        assert time.monotonic() < end, what
        time.sleep(0.05)


@contextmanager
def run_that_goes_on(folder: Path) -> Iterator[tuple[FakeRun, RecordWriter]]:
    """A record of five rounds so far, under `runs`."""
    fake = FakeRun(n=4, rounds=5)
    (folder / "runs" / "new").mkdir(parents=True)
    with RecordWriter(folder / "runs" / "new" / "run.mcap") as writer:
        fake.write(writer, finish=False)
        yield fake, writer


def ready(page: Page) -> None:
    page.locator("#app .flock-arena canvas[data-round]").first.wait_for()
    # The words beside the time line come from the server: it knows of the page from then on.
    expect(page.locator(".flock-where")).to_contain_text("of")


def choose(page: Page, robot: int) -> None:
    arena = page.locator("#app .flock-arena canvas").first
    arena.focus()
    for _ in range(robot + 1):
        page.keyboard.press("]")
    expect(page.locator(".flock-mind").first).to_contain_text(f"Robot {robot} ·")


@pytest.fixture(scope="module")
def replay(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("replay")
    (folder / "one").mkdir()
    make_record(folder / "one" / "run.mcap", n=6, rounds=12)
    with viewer(folder, "one") as url:
        yield url


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [400, 1280])
def test_a_record_is_replayed(replay: str, browser: Browser, width: int, dark: bool) -> None:
    with page_at(browser, replay, width=width, dark=dark) as page:
        ready(page)
        expect(page.locator(".flock-where")).to_have_text("round 0 of 12")
        expect(page.get_by_text("simulated language models")).to_be_visible()
        expect(page.locator(".flock-state")).to_have_text("formed in round 12")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate("document.body.classList.contains('body--dark')") is dark
        page.keyboard.press("ArrowRight")
        page.keyboard.press("ArrowRight")
        expect(page.locator(".flock-where")).to_have_text("round 2 of 12")
        until(lambda: shown_round(page) == 2, "the arena shows round 2")
        page.keyboard.press("Space")
        until(lambda: shown_round(page) >= 4, "it plays")
        page.keyboard.press("Space")
        page.keyboard.press("Home")
        until(lambda: shown_round(page) == 0, "back at the start")
        page.get_by_role("tab", name="Plots").click()
        expect(page.locator(".flock-plots canvas")).to_be_visible()
        page.get_by_label("Light or dark").click()
        page.wait_for_function(f"document.body.classList.contains('body--dark') === {str(not dark).lower()}")


def test_the_run_is_drawn_before_the_viewer_is_there_and_stays_at_its_round(tmp_path: Path, browser: Browser) -> None:
    make_record(tmp_path / "one" / "run.mcap", n=6, rounds=12)
    with viewer(tmp_path, "one") as url, page_at(browser, url) as page:
        page.locator("#flock-preview .flock-arena canvas[data-round='0']").wait_for()
        assert page.locator("#app").count() == 0, "nothing but the first look is there yet"
        page.keyboard.press("ArrowRight")
        page.keyboard.press("ArrowRight")
        page.locator("#flock-preview .flock-arena canvas[data-round='2']").wait_for()
        ready(page)
        expect(page.locator(".flock-where")).to_have_text("round 2 of 12")
        expect(page.locator("#flock-preview")).to_have_count(0)
        assert shown_round(page) == 2


def test_a_live_run_stays_at_the_round_that_was_chosen_before_the_viewer_was_there(
    tmp_path: Path, browser: Browser
) -> None:
    with run_that_goes_on(tmp_path), viewer(tmp_path, "--live") as url, page_at(browser, url) as page:
        page.locator("#flock-preview .flock-arena canvas[data-round='5']").wait_for()
        page.keyboard.press("ArrowLeft")
        page.locator("#flock-preview .flock-arena canvas[data-round='4']").wait_for()
        ready(page)
        expect(page.locator(".flock-where")).to_have_text("round 4 of 5")
        page.keyboard.press("End")
        expect(page.locator(".flock-state")).to_have_text("live")


def test_the_time_line_is_scrubbed_and_its_marks_are_clicked(replay: str, browser: Browser) -> None:
    with page_at(browser, replay) as page:
        ready(page)
        line = page.locator(".flock-time canvas")
        box = line.bounding_box()
        assert box is not None
        left, right = box["x"] + 64, box["x"] + box["width"] - 14
        page.mouse.move(left + 2, box["y"] + box["height"] - 8)
        page.mouse.down()
        for share in (0.25, 0.5, 0.75, 1.0):
            page.mouse.move(left + share * (right - left), box["y"] + box["height"] - 8)
            expect(page.locator(".flock-where")).to_have_text(f"round {round(12 * share)} of 12")
        page.mouse.up()
        page.keyboard.press("Home")
        # The first lane is of plans: a click beside a mark goes to the mark.
        page.mouse.click(left + (right - left) * 5 / 12 + 6, box["y"] + 8)
        expect(page.locator(".flock-where")).to_have_text("round 5 of 12")
        page.get_by_role("tab", name="Events").click()
        expect(page.get_by_text("6 events in round 5")).to_be_visible()


def test_a_conversation_is_read_and_two_robots_are_compared(replay: str, browser: Browser) -> None:
    with page_at(browser, replay) as page:
        ready(page)
        page.keyboard.press("ArrowRight")
        choose(page, 2)
        mind = page.locator(".flock-mind").first
        expect(mind).to_contain_text("Position: [1.0, 2.0]")
        expect(mind).to_contain_text("used: next waypoint (1, 2)")
        expect(mind).to_contain_text("300 tokens in, 20 out · 0.25 s")
        mind.get_by_text("Prompt (2 messages)").click()
        expect(mind).to_contain_text("You are a robot.")
        page.get_by_label("Compare with").click()
        page.get_by_role("option", name="4", exact=True).click()
        expect(page.locator(".flock-mind")).to_have_count(2)
        first, second = (page.locator(".flock-mind").nth(k).bounding_box() for k in (0, 1))
        assert first is not None and second is not None
        assert second["x"] >= first["x"] + first["width"], "side by side"


def test_a_run_is_saved_as_record_and_figure(replay: str, browser: Browser) -> None:
    with page_at(browser, replay) as page:
        ready(page)
        for words, start in (("Record (MCAP)", b"\x89MCAP0\r\n"), ("Figure (PNG)", b"\x89PNG")):
            page.get_by_role("button", name="Export").click()
            with page.expect_download() as download:
                page.get_by_text(words).click()
            assert Path(download.value.path()).read_bytes().startswith(start)


def test_hostile_words_stay_words(tmp_path: Path, browser: Browser) -> None:
    folder = tmp_path / "`${window.broken=6}` <img src=x onerror=window.broken=7>"
    with RecordWriter(folder / "run.mcap") as writer:
        fake = FakeRun(n=3, rounds=2)

        class Hostile:
            """Puts hostile words wherever a model or a peer can put any."""

            def write(self, entry: Entry) -> None:
                writer.write(self.changed(entry))

            def changed(self, entry: Entry) -> Entry:
                if isinstance(entry, RunInfo):
                    return entry.model_copy(update={"config": {"model": {"model": HOSTILE}}})
                if isinstance(entry, ProtocolEvent):
                    return entry.model_copy(update={"kind": "rejected_message", "detail": {"detail": HOSTILE}})
                if not isinstance(entry, LlmEntry):
                    return entry
                changes: dict[str, Any] = {"text": HOSTILE, "rejected": HOSTILE, "parsed": None, "model": HOSTILE}
                if entry.robot == 1:
                    changes = {"text": None, "error": HOSTILE, "parsed": None, "faults": [HOSTILE]}
                if entry.robot == 2:
                    changes = {"text": HOSTILE, "parsed": {"waypoint": HOSTILE}, "kind": HOSTILE}
                return llm_entry(entry.round, entry.robot, messages=[{"role": HOSTILE, "text": HOSTILE}], **changes)

        fake.write(Hostile())
    with viewer(tmp_path, folder.name) as url, page_at(browser, url) as page:
        ready(page)
        page.keyboard.press("ArrowRight")
        for robot in range(3):
            page.locator("#app .flock-arena canvas").first.focus()
            page.keyboard.press("]")
            mind = page.locator(".flock-mind").first
            expect(mind).to_contain_text(f"Robot {robot} ·")
            expect(mind).to_contain_text(HOSTILE)
            mind.get_by_text("Prompt (1 messages)").click()
            expect(mind.locator(".flock-prompt .flock-said")).to_have_text(HOSTILE)
        page.get_by_role("tab", name="Events").click()
        expect(page.locator(".flock-event").first).to_contain_text(HOSTILE)
        assert page.evaluate("window.broken") is None
        page.goto(f"{url}runs")
        expect(page.get_by_text(folder.name)).to_be_visible()
        expect(page.get_by_text(HOSTILE)).to_be_visible()
        assert page.evaluate("window.broken") is None
        assert page.locator("iframe").count() == 0 and page.locator("img[src=x]").count() == 0


def test_a_record_is_followed_while_it_is_written(tmp_path: Path, browser: Browser) -> None:
    with (
        run_that_goes_on(tmp_path) as (fake, writer),
        viewer(tmp_path, "--live") as url,
        page_at(browser, url) as page,
    ):
        ready(page)
        expect(page.locator(".flock-where")).to_have_text("round 5 of 5")
        expect(page.locator(".flock-state")).to_have_text("live")
        for number in range(6, 15):
            fake.write_round(writer, number)
        expect(page.locator(".flock-where")).to_have_text("round 14 of 14")
        until(lambda: shown_round(page) == 14, "the arena follows")
        page.keyboard.press("ArrowLeft")
        expect(page.locator(".flock-state")).to_have_text("still running")
        fake.write_round(writer, 15)
        expect(page.locator(".flock-where")).to_have_text("round 13 of 15")
        page.keyboard.press("End")
        expect(page.locator(".flock-where")).to_have_text("round 15 of 15")
        writer.write(SummaryMessage(result={"formed": False, "stopped": "rounds"}))
        writer.close()
        expect(page.locator(".flock-state")).to_have_text("not formed (rounds)")


def test_a_run_is_flown_steered_and_disturbed(tmp_path: Path, browser: Browser) -> None:
    with viewer(tmp_path) as url, page_at(browser, url) as page:
        expect(page.get_by_text("This needs a language model")).to_be_visible()
        expect(page.get_by_role("button", name="Read")).to_be_disabled()
        page.get_by_label("Robots", exact=True).fill("0")
        page.get_by_role("button", name="Start", exact=True).click()
        expect(page.get_by_role("alert")).to_contain_text("error: n_robots = 0 is not allowed")
        page.get_by_label("Robots", exact=True).fill("5")
        page.get_by_label("Model", exact=True).fill("openai:gpt-5")
        page.get_by_role("button", name="Start", exact=True).click()
        expect(page.get_by_role("alert")).to_contain_text("llm-flock view --model")
        page.get_by_label("Model", exact=True).fill("simulated:ideal")
        page.get_by_label("Rounds a second").fill("10")
        page.get_by_role("button", name="Start", exact=True).click()
        ready(page)
        assert page.url.endswith("/run/1")
        expect(page.get_by_text("simulated language models")).to_be_visible()
        until(lambda: shown_round(page) >= 3, "it flies")
        page.get_by_label("Shape").fill("cross")
        page.get_by_role("button", name="Give the mission").click()
        expect(page.locator(".flock-steered")).to_contain_text("mission given to robot 0")
        page.get_by_label("Shape").fill("nonsense")
        page.get_by_role("button", name="Give the mission").click()
        expect(page.locator(".flock-steered")).to_contain_text("error: changes")
        page.get_by_role("button", name="Hallucinate").click()
        expect(page.locator(".flock-steered")).to_contain_text("nonsense answers")
        page.get_by_role("button", name="Kill").click()
        expect(page.locator(".flock-steered")).to_contain_text("robot killed")
        page.wait_for_timeout(500)
        page.get_by_role("button", name="Kill").click()
        expect(page.locator(".flock-steered")).to_contain_text("error: kill")
        page.get_by_role("button", name="End run").click()
        expect(page.locator(".flock-state")).to_contain_text("formed")
        marks = page.evaluate("[...globalThis.flockClock('main').runs[0].marks.values()].map(Object.keys).flat()")
        assert {"missions", "faults", "plans"} <= set(marks)
    (record,) = (tmp_path / "runs").glob("*/run.mcap")
    assert b"injected" in record.read_bytes()


def test_two_protocols_fly_side_by_side(tmp_path: Path, browser: Browser) -> None:
    with viewer(tmp_path) as url, page_at(browser, url) as page:
        page.get_by_label("Rounds at most").fill("6")
        page.get_by_label("Rounds a second").fill("20")
        page.get_by_role("button", name="Paper against flock").click()
        ready(page)
        expect(page.locator("#app .flock-arena")).to_have_count(2)
        expect(page.locator(".flock-state")).to_contain_text("formed", timeout=20_000)
        page.keyboard.press("End")
        until(lambda: {shown_round(page, 0), shown_round(page, 1)} == {6}, "both end")
        starts = [page.evaluate(f"globalThis.flockClock('main').runs[{k}].frames.get(6) && 1 || 0") for k in (0, 1)]
        assert starts == [1, 1]


class Answering(BaseHTTPRequestHandler):
    """A model that reads every request as the same mission."""

    answer = json.dumps({"shape": "square", "n_robots": 8, "center": [40, 60], "spacing": 8})

    def do_POST(self) -> None:
        self.rfile.read(int(self.headers["content-length"]))
        message = {"role": "assistant", "content": type(self).answer}
        body = json.dumps(
            {
                "id": "1",
                "object": "chat.completion",
                "created": 1,
                "model": "reader",
                "choices": [{"index": 0, "finish_reason": "stop", "message": message}],
                "usage": {"prompt_tokens": 1, "completion_tokens": 1, "total_tokens": 2},
            }
        ).encode()
        self.send_response(200)
        self.send_header("content-type", "application/json")
        self.send_header("content-length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        pass


def test_a_mission_in_words_is_confirmed_before_it_flies(tmp_path: Path, browser: Browser) -> None:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Answering)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    base = f"http://127.0.0.1:{server.server_port}/v1"
    try:
        with (
            viewer(tmp_path, "--model", "openai:reader", "--base-url", base) as url,
            page_at(browser, url) as page,
        ):
            page.get_by_label("Mission in plain words").and_(page.locator("textarea")).fill(
                "eight drones in a square around 40, 60, 8 apart"
            )
            page.get_by_role("button", name="Read").click()
            expect(page.get_by_text("8 robots · square · centre 40, 60 · 8 units apart")).to_be_visible(timeout=20_000)
            expect(page.get_by_label("Robots", exact=True)).to_have_value("10")
            page.get_by_role("button", name="Take it over").click()
            expect(page.get_by_label("Robots", exact=True)).to_have_value("8")
            expect(page.get_by_label("Centre")).to_have_value("40, 60")
            assert not list(tmp_path.glob("runs/*")), "nothing flies unasked"
    finally:
        server.shutdown()
        server.server_close()
