"""The viewer in a real browser: replay, live, scrub, conversation, cockpit and steering."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar

import pytest
from playwright.sync_api import Browser, expect
from sample_records import FakeRun, make_record
from viewer_pages import at, choose, go, keys_of, page_at, ready, shown_round, until, viewer

import llm_flock
from llm_flock.record._schema import SummaryMessage
from llm_flock.record._writer import RecordWriter


@contextmanager
def run_that_goes_on(folder: Path) -> Iterator[tuple[FakeRun, RecordWriter]]:
    """A record of five rounds so far, under `runs`."""
    fake = FakeRun(n=4, rounds=5)
    (folder / "runs" / "new").mkdir(parents=True)
    with RecordWriter(folder / "runs" / "new" / "run.mcap") as writer:
        fake.write(writer, finish=False)
        yield fake, writer


@pytest.fixture(scope="module")
def replay(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("replay")
    (folder / "one").mkdir()
    make_record(folder / "one" / "run.mcap", n=6, rounds=12)
    with viewer(folder, "one") as url:
        yield url


@pytest.mark.parametrize(("width", "dark"), [(400, True), (1280, False)])
def test_a_record_is_replayed(replay: str, browser: Browser, width: int, dark: bool) -> None:
    with page_at(browser, replay, width=width, dark=dark) as page:
        ready(page)
        expect(page.locator(".flock-where")).to_have_text("round 0 of 12")
        expect(page.get_by_text("simulated language models")).to_be_visible()
        expect(page.locator(".flock-headline")).to_have_text("Formed in round 12")
        expect(page.locator(".flock-state")).to_have_text("not formed yet")
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
        assert page.evaluate("document.body.classList.contains('body--dark')") is not dark


def test_the_whole_page_is_there_with_the_first_answer_and_stays(tmp_path: Path, browser: Browser) -> None:
    make_record(tmp_path / "one" / "run.mcap", n=6, rounds=12)
    with viewer(tmp_path, "one") as url, page_at(browser, url) as page:
        page.evaluate("window.first = true")
        ready(page)
        for there in (1, 2):
            page.keyboard.press("ArrowRight")
            until(lambda there=there: shown_round(page) == there, f"round {there} is shown")
        choose(page, 4)
        expect(page.locator(".flock-mind").first).to_contain_text("Robot 4 · round 2")
        page.get_by_role("tab", name="Events").click()
        expect(page.get_by_text("6 events in round 2")).to_be_visible()
        page.get_by_role("tab", name="Mind").click()
        page.keyboard.press("ArrowLeft")
        assert page.evaluate("window.first") is True, "the page never loads again"
        assert shown_round(page) in (1, 2)


def test_record_plays_on_appearing_unless_motion_is_reduced(replay: str, browser: Browser) -> None:
    with page_at(browser, replay, still=False) as page:
        ready(page)
        until(lambda: shown_round(page) >= 2, "it plays")
        page.keyboard.press("Space")
        stood = shown_round(page)
        page.wait_for_timeout(600)
        assert shown_round(page) == stood
    with page_at(browser, replay) as page:
        ready(page)
        page.wait_for_timeout(600)
        assert shown_round(page) == 0


def test_a_live_run_stays_at_the_round_that_was_chosen(tmp_path: Path, browser: Browser) -> None:
    with run_that_goes_on(tmp_path), viewer(tmp_path, "--live") as url, page_at(browser, url) as page:
        page.locator(".flock-arena canvas[data-round='5']").wait_for()
        page.keyboard.press("ArrowLeft")
        page.locator(".flock-arena canvas[data-round='4']").wait_for()
        expect(page.locator(".flock-where")).to_have_text("round 4 of 5")
        expect(page.locator(".flock-state")).to_contain_text("still running")
        page.keyboard.press("End")
        expect(page.locator(".flock-state")).to_contain_text("live")


def test_the_time_line_is_scrubbed_and_its_marks_are_clicked(replay: str, browser: Browser) -> None:
    with page_at(browser, replay) as page:
        ready(page)
        line = page.locator(".flock-time canvas")
        box = line.bounding_box()
        assert box is not None
        left, right = box["x"] + 72, box["x"] + box["width"] - 14
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
        page.get_by_label("Find in all rounds").fill("robot 3 took")
        expect(page.get_by_text("12 events in all rounds")).to_be_visible()
        page.get_by_role("button", name="Round 9").click()
        expect(page.locator(".flock-where")).to_have_text("round 9 of 12")


def test_a_conversation_is_read_and_two_robots_are_compared(replay: str, browser: Browser) -> None:
    with page_at(browser, replay) as page:
        ready(page)
        page.keyboard.press("ArrowRight")
        choose(page, 2)
        mind = page.locator(".flock-mind").first
        expect(mind).to_contain_text("Position: [1.0, 2.0]")
        expect(mind).to_contain_text("used: next waypoint (1, 2)")
        expect(mind).to_contain_text("300 tokens in, 20 out · 0.25 s")
        page.context.grant_permissions(["clipboard-read", "clipboard-write"])
        page.get_by_role("button", name="Copy a link to this moment").click()
        expect(page.get_by_role("button", name="Copy a link to this moment")).to_have_text("Copied")
        link = page.evaluate("navigator.clipboard.readText()")
        assert re.search(r"/run/[0-9a-f]{12}#round=1&robots=2&tab=mind$", link) and "token" not in link
        page.evaluate(
            "(link) => { location.href = link; }",
            link.replace("round=1&robots=2", "round=7&robots=4") + "&view=formation",
        )
        until(lambda: shown_round(page) == 7, "another moment of the same run")
        expect(mind).to_contain_text("Robot 4 · round 7")
        until(lambda: page.url.endswith("#round=7&robots=4&tab=mind&view=formation"), "it stays in the address")
        page.reload()
        expect(mind).to_contain_text("Robot 4 · round 7")
        go(page, link)
        expect(mind).to_contain_text("Robot 2 · round 1")
        mind.get_by_text("Prompt (2 messages)").click()
        expect(mind).to_contain_text("You are a robot.")
        page.keyboard.press("ArrowRight")
        expect(mind).to_contain_text("round 2")
        expect(mind.locator(".flock-prompt")).to_contain_text("You are a robot.")  # it stays open
        page.get_by_label("Compare with").select_option("0:4")
        expect(page.locator(".flock-mind")).to_have_count(2)
        first, second = (page.locator(".flock-mind").nth(k).bounding_box() for k in (0, 1))
        assert first is not None and second is not None
        assert second["x"] >= first["x"] + first["width"], "side by side"


def test_a_link_leads_to_its_moment_once_the_token_is_there(replay: str, browser: Browser) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 844}, reduced_motion="reduce")
    page = context.new_page()
    go(page, replay)
    ready(page)
    page.evaluate("flockClock().seek(5)")
    until(lambda: "round=5" in page.evaluate("location.hash"), "the moment is in the address")
    expect(page.locator(".flock-brief")).to_contain_text(re.compile(r"Robot \d in round 5: ✓ “"))
    link = page.url
    context.clear_cookies()
    page.goto("about:blank")
    page.goto(link)
    for given, said in (("nonsense", "not the token"), (replay, "")):
        page.get_by_label("Address or token").fill(given)
        page.get_by_role("button", name="Open").click()
        if said:
            expect(page.get_by_role("status")).to_contain_text(said)
    until(lambda: shown_round(page) == 5 and page.url == link, "the page of the link")
    context.close()


def test_a_run_is_saved_as_record_and_figure(replay: str, browser: Browser) -> None:
    with page_at(browser, replay) as page:
        ready(page)
        for words, start in (("Record (MCAP)", b"\x89MCAP0\r\n"), ("Figure (PNG)", b"\x89PNG")):
            page.get_by_role("button", name="Export").click()
            with page.expect_download() as download:
                page.get_by_role("button", name=words).click()
            assert Path(download.value.path()).read_bytes().startswith(start)
            page.keyboard.press("Escape")


def test_a_record_is_followed_while_it_is_written(tmp_path: Path, browser: Browser) -> None:
    with (
        run_that_goes_on(tmp_path) as (fake, writer),
        viewer(tmp_path, "--live") as url,
        page_at(browser, url) as page,
    ):
        ready(page)
        expect(page.locator(".flock-where")).to_have_text("round 5 of 5")
        expect(page.locator(".flock-state")).to_contain_text("live")
        for number in range(6, 15):
            fake.write_round(writer, number)
        expect(page.locator(".flock-where")).to_have_text("round 14 of 14")
        until(lambda: shown_round(page) == 14, "the arena follows")
        until(lambda: page.evaluate("flockClock().runs[0].frames.size") == 15, "no round is passed over")
        page.keyboard.press("ArrowLeft")
        expect(page.locator(".flock-state")).to_contain_text("still running")
        fake.write_round(writer, 15)
        expect(page.locator(".flock-where")).to_have_text("round 13 of 15")
        page.keyboard.press("End")
        expect(page.locator(".flock-where")).to_have_text("round 15 of 15")
        writer.write(SummaryMessage(result={"formed": False, "stopped": "rounds"}))
        writer.close()
        expect(page.locator(".flock-headline")).to_have_text("Not formed: all 15 rounds were used up")


ORDER = """async (order) => {
    const answer = await fetch("/order", {
        method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(order) });
    return (await answer.json()).error;
}"""


def test_no_banner_is_green_over_a_hole(tmp_path: Path, browser: Browser) -> None:
    with viewer(tmp_path) as url, page_at(browser, url) as page:
        page.get_by_label("Robots", exact=True).fill("5")
        page.get_by_label("Model", exact=True).fill("simulated:ideal")
        gaps = page.get_by_label("Places of the dead")
        expect(page.locator(".flock-labelled", has=gaps)).to_contain_text("stay empty")
        gaps.select_option("replan")
        expect(page.locator(".flock-labelled", has=gaps)).to_contain_text("a smaller formation")
        page.get_by_role("button", name="Start", exact=True).click()
        ready(page)
        (key,) = keys_of(url)
        banner, said = page.locator(".flock-banner"), page.locator(".flock-headline")
        expect(banner).to_have_attribute("data-tone", "good")
        expect(said).to_have_text(re.compile(r"Formed in round \d+"))
        page.evaluate(ORDER, {"order": "kill", "runs": [key], "robot": 3})
        was = r"Formed in rounds \d+ to \d+, then robot 3 died; place \d is empty"
        expect(said).to_have_text(re.compile(was))
        expect(banner).to_have_attribute("data-tone", "open")
        expect(page.locator(".flock-state")).to_contain_text("not now")
        # A smaller formation is whole again.
        expect(banner).to_have_attribute("data-tone", "good")
        expect(said).to_have_text(
            re.compile(r"Formed in rounds \d+ to \d+, then robot 3 died; formed again in round \d+")
        )


def test_a_run_is_flown_steered_and_disturbed(tmp_path: Path, browser: Browser) -> None:
    with viewer(tmp_path) as url, page_at(browser, url) as page:
        expect(page.get_by_text("This needs a language model")).to_be_visible()
        expect(page.get_by_role("button", name="Read")).to_be_disabled()
        page.get_by_label("Robots", exact=True).fill("0")
        page.get_by_role("button", name="Start", exact=True).click()
        robots = page.get_by_label("Robots", exact=True)
        expect(robots).to_have_attribute("aria-invalid", "true")
        expect(page.locator(".flock-labelled", has=robots).locator(".flock-wrong")).to_have_text("Expected at least 1")
        expect(robots).to_be_focused()
        page.get_by_label("Robots", exact=True).fill("5")
        page.get_by_label("Model", exact=True).fill("openai:gpt-5")
        page.get_by_role("button", name="Start", exact=True).click()
        model = page.locator(".flock-labelled", has=page.get_by_label("Model", exact=True))
        expect(model.locator(".flock-wrong")).to_contain_text("llm-flock view --model")
        page.get_by_label("Model", exact=True).fill("simulated:ideal")
        pace = page.get_by_label("Rounds a second")
        pace.press("End")
        expect(pace).to_have_attribute("aria-valuetext", "100 rounds a second")
        pace.fill("9")  # the tenth pace
        page.get_by_role("button", name="Start", exact=True).click()
        ready(page)
        (key,) = keys_of(url)
        assert f"/run/{key}" in page.url
        expect(page.get_by_text("simulated language models")).to_be_visible()
        until(lambda: shown_round(page) >= 3, "it flies")
        page.get_by_label("Shape", exact=True).fill("cross")
        page.get_by_role("button", name="Give the mission").click()
        said = page.locator(".flock-steered")
        expect(said).to_contain_text("Robot 0 has the mission")
        expect(page.locator(".flock-missions")).to_contain_text("2. cross of 5 (from round")
        page.get_by_label("Shape", exact=True).fill("nonsense")
        page.get_by_role("button", name="Give the mission").click()
        expect(said).to_contain_text("error:")
        page.get_by_role("button", name="Hallucinate").click()
        expect(said).to_contain_text("answers nonsense from now on")
        page.get_by_role("button", name="Kill").click()
        expect(said).to_contain_text("Robot 0 dies")
        for name in ("Kill", "Hallucinate"):
            expect(page.get_by_role("button", name=name)).to_be_disabled()
        expect(page.locator(".flock-why-not")).to_have_text("Robot 0 is dead.")
        page.get_by_label("Robot to disturb").select_option("1")
        expect(page.get_by_role("button", name="Kill")).to_be_enabled()
        page.get_by_role("button", name="Hold the run").click()
        expect(page.locator(".flock-state")).to_contain_text("the run is held")
        page.get_by_role("button", name="Let the run fly on").click()
        expect(said).to_contain_text("flies on")
        refused = page.evaluate(ORDER, {"order": "kill", "runs": [key], "robot": 0})
        assert refused == "Robot 0 is dead."
        page.get_by_role("button", name="End the run").click()
        expect(page.locator(".flock-why-not")).to_have_text("The run is over: it takes no more orders.")
        expect(page.get_by_role("button", name="Give the mission")).to_be_disabled()
        refused = page.evaluate(ORDER, {"order": "kill", "runs": [key], "robot": 1})
        assert refused == "The run is over: it takes no more orders."
        marks = page.evaluate("[...globalThis.flockClock('main').runs[0].marks.values()].map(Object.keys).flat()")
        assert {"missions", "faults", "plans"} <= set(marks)
    (record,) = (tmp_path / "runs").glob("*/run.mcap")
    assert b"injected" in record.read_bytes()


def test_two_protocols_fly_side_by_side(tmp_path: Path, browser: Browser) -> None:
    with viewer(tmp_path) as url, page_at(browser, url) as page:
        page.get_by_label("Rounds at most").fill("6")
        page.get_by_label("Rounds a second").fill("11")  # the twelfth pace
        ground = page.locator(".flock-ground canvas")
        expect(ground).to_have_attribute("data-starts", re.compile("^[0-9.]+,"))
        x, y = (float(part) for part in (ground.get_attribute("data-starts") or "").split()[0].split(","))
        ground.scroll_into_view_if_needed()
        box = ground.bounding_box()
        assert box is not None
        middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2 - 11  # the ruler's room is below
        page.mouse.move(*middle)
        page.mouse.down()
        page.mouse.move(middle[0] + 8, middle[1], steps=2)
        page.mouse.up()
        expect(page.get_by_label("Centre", exact=True)).not_to_have_value("50, 50")
        page.get_by_role("button", name="Undo").click()
        expect(page.get_by_label("Centre", exact=True)).to_have_value("50, 50")
        ground.focus()
        for key in ("]", "ArrowRight", "ArrowRight"):  # from the centre to robot 0
            page.keyboard.press(key)
        page.get_by_role("button", name="Undo").click()
        started = [round(x + 1, 1), y]
        expect(ground).to_have_attribute("data-starts", re.compile(f"^{started[0]:.1f},{started[1]:.1f} "))
        page.get_by_role("button", name="Paper against flock").click()
        ready(page)
        expect(page.locator("main .flock-arena")).to_have_count(2)
        expect(page.locator(".flock-state").first).to_contain_text("formed", timeout=20_000)
        page.keyboard.press("End")
        until(lambda: {shown_round(page, 0), shown_round(page, 1)} == {6}, "both end")
        page.keyboard.press("Home")
        until(lambda: {shown_round(page, 0), shown_round(page, 1)} == {0}, "both are at their starts")
        starts = [page.evaluate(f"globalThis.flockClock('main').runs[{k}].frames.get(0).x[0]") for k in (0, 1)]
        assert starts == [started, started], "where the robot was moved to"
        canvases = page.locator("main .flock-arena canvas")
        until(lambda: len({canvases.nth(k).get_attribute("data-scale") for k in (0, 1)}) == 1, "both have one scale")


def test_first_screen_names_the_robot_that_prevented_forming(tmp_path: Path, browser: Browser) -> None:
    models = "3=simulated:malformed,0-2=simulated:ideal,4-5=simulated:ideal"
    llm_flock.run(
        shape="circle", n_robots=6, seed=2, model=models, fallback="hold", rounds=15, out=str(tmp_path / "bad")
    )
    with viewer(tmp_path, "bad") as url, page_at(browser, url) as page:
        ready(page)
        expect(page.locator(".flock-banner")).to_contain_text("Not formed: all 15 rounds were used up")
        expect(page.locator(".flock-banner")).to_contain_text("protocol: flock")
        said = "Robot 3: its model (simulated:malformed) gave no usable answer in 45 of 45 calls"
        expect(page.locator(".flock-why")).to_contain_text(said)
        expect(page.locator(".flock-mind")).to_contain_text("Robot 3 · round 0")
        page.keyboard.press("ArrowRight")
        expect(page.locator(".flock-mind")).to_contain_text("refused: it holds no complete plan")
        box = page.locator(".flock-time canvas").bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + 72 + (box["width"] - 86) / 15, box["y"] + 40)
        expect(page.locator(".flock-time .flock-tip")).to_contain_text("Round 1 · ")
        page.set_viewport_size({"width": 390, "height": 844})  # a phone: the arena comes first
        arena, time_line = page.locator(".flock-arena canvas"), page.locator(".flock-time")
        show = page.get_by_role("button", name="Show robot 3")
        expect(show).to_be_hidden()
        boxes = [one.bounding_box() for one in (arena, time_line)]
        assert boxes[0] and boxes[1] and boxes[0]["y"] + boxes[0]["height"] < boxes[1]["y"], "no part of it is hidden"
        page.get_by_role("button", name="More").click()
        expect(show).to_be_visible()


def test_stacked_robots_fan_out_and_are_counted(tmp_path: Path, browser: Browser) -> None:
    models = "simulated:collapse@0.3,distorted@0.3"
    folder = str(tmp_path / "crowd")
    llm_flock.run(shape="circle", n_robots=8, seed=1, protocol="paper-literal", model=models, rounds=15, out=folder)
    with viewer(tmp_path, "crowd") as url, page_at(browser, url) as page:
        ready(page)
        page.keyboard.press("End")
        until(lambda: shown_round(page) == 15, "the last round")
        near = page.locator("main .flock-arena canvas").get_attribute("data-near")
        marked = page.evaluate("flockClock().runs[0].marks.get(15)['too close']")
        assert int(near or 0) == marked > 0, "the arena and the time line count the same pairs"


def test_runs_are_sorted_filtered_compared_and_deleted(tmp_path: Path, browser: Browser) -> None:
    for name, rounds, agree in (("alpha", 4, True), ("beta", 9, False), ("gamma", 6, True)):
        make_record(tmp_path / name / "run.mcap", n=4, rounds=rounds, agree=agree)
    with viewer(tmp_path, "alpha", "beta", "gamma") as url, page_at(browser, at(url, "runs")) as page:
        rows = page.locator("tbody tr")
        expect(rows).to_have_count(3)
        names = page.locator("tbody tr a")
        page.get_by_role("button", name="Run", exact=True).click()
        expect(names).to_have_text(["alpha", "beta", "gamma"])
        page.get_by_role("button", name="Run ▲").click()
        expect(names).to_have_text(["gamma", "beta", "alpha"])
        page.get_by_label("Search").fill("formed in")
        expect(names).to_have_text(["gamma", "alpha"])
        page.get_by_label("Compare gamma").check()
        page.get_by_label("Compare alpha").check()
        expect(page.locator(".flock-compared")).to_contain_text("Shape error [units]")
        expect(page.get_by_role("link", name="Play these two")).to_have_attribute(
            "href", re.compile("/pair/[0-9a-f]{12}/[0-9a-f]{12}$")
        )
        page.get_by_role("button", name="Delete alpha").click()
        page.get_by_role("dialog").get_by_role("button", name="Keep it").click()
        assert (tmp_path / "alpha" / "run.mcap").exists()
        page.get_by_role("button", name="Delete alpha").click()
        expect(page.get_by_role("dialog")).to_contain_text("The record of “alpha” is deleted")
        page.get_by_role("dialog").get_by_role("button", name="Delete").click()
        expect(names).to_have_text(["gamma"])
        assert not (tmp_path / "alpha").exists() and (tmp_path / "gamma" / "run.mcap").exists()
        page.get_by_label("Search").fill("")
        make_record(tmp_path / "runs" / "delta" / "run.mcap", n=4, rounds=4)
        expect(names).to_have_text(["gamma", "delta", "beta"])


class Answering(BaseHTTPRequestHandler):
    """A model that reads every request as the same mission."""

    part: ClassVar[dict[str, Any]] = {"shape": "square", "center": [40, 60], "spacing": 8}
    answer = json.dumps({"answer": "mission", "robots": 8, "stages": [{"parts": [part]}]})

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


def test_described_mission_is_confirmed_before_it_flies(tmp_path: Path, browser: Browser) -> None:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Answering)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    base = f"http://127.0.0.1:{server.server_port}/v1"
    try:
        with (
            viewer(tmp_path, "--model", "openai:reader", "--base-url", base) as url,
            page_at(browser, url) as page,
        ):
            words = page.get_by_label("Mission in plain words").and_(page.locator("textarea"))
            words.fill("too long " * 300)
            page.get_by_role("button", name="Read").click()
            expect(page.get_by_text("error: ")).to_contain_text("from 1 to 2000 letters")
            words.fill("eight drones in a square around 40, 60, 8 apart")
            page.get_by_role("button", name="Read").click()
            said = page.get_by_text("8 robots · a square around 40, 60, neighbours 8 apart")
            expect(said).to_be_visible(timeout=20_000)
            assert not list(tmp_path.glob("runs/*")), "nothing flies unasked"
            hostile = {"shape": "<img src=x onerror=window.broken=1>\u202e"}
            good, Answering.answer = (
                Answering.answer,
                Answering.answer.replace('"square"', json.dumps(hostile["shape"])),
            )
            page.get_by_role("button", name="Read").click()
            expect(page.get_by_text("error: ")).to_contain_text("broken=1>\\u202e", timeout=20_000)
            assert page.evaluate("window.broken") is None
            Answering.answer = good
            page.get_by_role("button", name="Read").click()
            page.get_by_role("button", name="Fly it").dblclick(timeout=20_000)
            expect(page).to_have_url(re.compile("/run/"), timeout=20_000)
            assert len(keys_of(url)) == 1
    finally:
        server.shutdown()
        server.server_close()
