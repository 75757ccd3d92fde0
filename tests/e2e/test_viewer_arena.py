"""What the arena draws: words on no disk and no other word, crowds in which every robot is seen, and space."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect
from sample_records import FakeRun, make_record
from viewer_pages import at, go, page_at, ready, viewer

from llm_flock.record._schema import Entry, State
from llm_flock.record._writer import RecordWriter
from llm_flock_view._viewer.page import bundle

PLACE = """([n, wide, seed]) => {
    let state = seed;
    const random = () => { state = (state * 1103515245 + 12345) % 2147483648; return state / 2147483648; };
    const { fanned, spots, tooNear } = modules["llm-flock-viewer/crowd.js"];
    const { around, placed } = modules["llm-flock-viewer/labels.js"];
    const pixels = [];
    for (let k = 0; k < n; k += 1) {
        pixels.push(k % 5 === 4 ? [...pixels[k - 1]] : [300 + (random() - 0.5) * wide, 200 + (random() - 0.5) * wide]);
    }
    const { at, crowds } = fanned(pixels, 9);
    const disks = at.map(([x, y]) => [x, y, 11]);
    const words = at.map((_, k) => (k % 7 === 6 ? null : [14 + (k % 3) * 12, 14]));
    tooNear(crowds, [[3, 4]]);
    const tags = spots(crowds, disks, 9, [600, 400], []);
    const found = placed(disks, words, [600, 400], [[0, 360, 110, 400], ...tags]);
    const boxes = found.map((offset, k) => offset && around([at[k][0] + offset[0], at[k][1] + offset[1]], words[k]));
    const counted = crowds.filter((one) => one.counted).map((one) => one.middle);
    return { at, boxes, counted, crowds: crowds.length, tags,
        near: crowds.filter((one) => one.near).map((one) => one.members) };
}"""


@pytest.fixture(scope="module")
def scripts(browser: Browser) -> Any:
    """The viewer's own scripts in an empty page, for the functions that decide where something is drawn."""
    page = browser.new_page()
    parts = bundle(("geometry", "labels", "crowd")).split("\n// The first script", 1)[0]
    page.add_script_tag(
        content=parts[: parts.rindex("})();") + len("})();")].replace("const modules", "var modules", 1)
    )
    yield page
    page.close()


def test_disks_in_perspective_step_aside_and_keep_their_size(scripts: Page) -> None:
    aside = (
        """() => modules["llm-flock-viewer/crowd.js"].fanned([[50, 50, 1.2], [50, 50, 0.8], [90, 50, 1]], 9, true)"""
    )
    found = scripts.evaluate(aside)
    (ax, ay, near), (bx, by, far), third = found["at"]
    assert found["crowds"] == [] and (near, far, third) == (1.2, 0.8, [90, 50, 1])
    assert math.hypot(bx - ax, by - ay) >= 1.6 * 9, "both numbers can be read"
    assert math.hypot(ax - 50, ay - 50) <= 9, "within its own radius"


@pytest.mark.parametrize(("n", "wide"), [(5, 300), (12, 60), (30, 250), (60, 300), (100, 500)])
def test_no_word_lies_on_a_disk_or_on_another_word(scripts: Page, n: int, wide: float) -> None:
    for seed in range(1, 6):
        found = scripts.evaluate(PLACE, [n, wide, seed])
        boxes = [box for box in found["boxes"] if box]
        assert boxes and found["crowds"] >= 1
        for k, (left, top, right, bottom) in enumerate(boxes):
            assert left >= 0 and top >= 0 and right <= 600 and bottom <= 400
            assert not (left < 110 and bottom > 360), "what is taken stays free"
            for other in boxes[k + 1 :]:
                assert not (left < other[2] and other[0] < right and top < other[3] and other[1] < bottom)
            for other in found["tags"]:
                assert not (left < other[2] and other[0] < right and top < other[3] and other[1] < bottom)
            for x, y in found["at"]:
                near = max(left, min(right, x)) - x, max(top, min(bottom, y)) - y
                assert near[0] ** 2 + near[1] ** 2 >= 11**2 - 1e-6
        assert len(found["tags"]) >= min(3, found["crowds"]), "the number of a crowd stands in it or beside it"
        assert [{3, 4} <= {*members} for members in found["near"]] == [True], "red is only the crowd with a near pair"
        for x, y in found["counted"]:
            assert all((x - a) ** 2 + (y - b) ** 2 >= (9 + 10) ** 2 - 1e-6 for a, b in found["at"])


OUTLINES = """() => {
    const { around, crosses, placed } = modules["llm-flock-viewer/labels.js"];
    const disk = [300, 200, 10];
    const lines = [[[300, 200], [300, 100]], [[250, 221], [350, 221]]];
    const word = [14, 14];
    const boxOf = ([offset]) => around([disk[0] + offset[0], disk[1] + offset[1]], word);
    const box = boxOf(placed([disk], [word], [600, 400], [], [], { rings: [[300, 200, 14]], lines }));
    const far = Math.hypot(Math.max(box[0] - 300, 300 - box[2], 0), Math.max(box[1] - 200, 200 - box[3], 0));
    const walls = [0, 1, 2, 3, 4, 5].map((k) => [[200, 150 + 20 * k], [400, 150 + 20 * k]]);
    const least = placed([disk], [word], [600, 400], [], [], { lines: walls });
    return { box, crossed: lines.some((line) => crosses(line, box)), far, still: boxOf(least) };
}"""


def test_viewer_word_crosses_outlines_only_without_clear_room(scripts: Page) -> None:
    found = scripts.evaluate(OUTLINES)
    assert not found["crossed"] and found["far"] > 14, "neither above, on its way, nor on the ring of its goal"
    assert found["still"], "rather on a line than nowhere"


def test_stacked_robots_are_not_too_close_nor_in_radio_range(tmp_path: Path, browser: Browser) -> None:
    with RecordWriter(tmp_path / "space" / "run.mcap") as writer:
        fake = FakeRun(n=3, rounds=1, dim=3)

        class Stacked:
            def write(self, entry: Entry) -> None:
                if isinstance(entry, State):
                    rows = [[50.0, 50.0, 10.0], [50.5, 50.0, 40.0], [51.0, 50.0, 50.0]]
                    entry = entry.model_copy(update={"positions": rows})
                writer.write(entry)

        fake.write(Stacked())
    with viewer(tmp_path, "space") as url, page_at(browser, url) as page:
        ready(page)
        canvas = page.locator("main .flock-arena canvas").first
        expect(canvas).to_have_attribute("data-crowds", "")  # in perspective they stand one above the other
        before = canvas.get_attribute("data-at")
        box = canvas.bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + 200, box["y"] + 200)
        page.mouse.down()
        page.mouse.move(box["x"] + 320, box["y"] + 220, steps=4)
        page.mouse.up()
        expect(page).to_have_url(re.compile("view=turn,"))
        assert canvas.get_attribute("data-at") != before, "a drag turns the picture"
        page.get_by_role("button", name="Side, ").click()
        expect(canvas).to_have_attribute("data-crowds", "")  # their heights are far apart
        page.get_by_role("button", name="Top, ").click()
        expect(canvas).to_have_attribute("data-near", "0")
        expect(canvas).to_have_attribute("data-links", "1")
        expect(canvas).to_have_attribute("data-crowds", "3")  # counted, and not red


def test_a_large_formation_keeps_its_disks_apart(tmp_path: Path, browser: Browser) -> None:
    make_record(tmp_path / "many" / "run.mcap", n=60, rounds=31, llm=False)
    with viewer(tmp_path, "many") as url, page_at(browser, url) as page:
        ready(page)
        page.keyboard.press("End")
        page.keyboard.press("f")
        canvas = page.locator("main .flock-arena canvas").first
        expect(canvas).to_have_attribute("data-round", "31")
        radius, scale = (float(canvas.get_attribute(f"data-{name}") or 0) for name in ("radius", "scale"))
        assert 2 * radius < 10.0 * scale, "the spacing is 10"
        legend = page.locator(".flock-legend")
        page.get_by_role("button", name="Legend").click()
        expect(legend.get_by_text("area: robots of one plan")).to_be_visible()
        expect(canvas).to_have_attribute("data-words", "2")  # the tag of the one plan, and the chosen robot
        expect(legend.get_by_text("safety disc")).to_be_hidden()
        page.get_by_role("checkbox", name="Safety discs").check()
        expect(legend.get_by_text("safety disc")).to_be_visible()


def test_the_legend_folds_where_a_window_becomes_narrow(tmp_path: Path, browser: Browser) -> None:
    make_record(tmp_path / "one" / "run.mcap", n=4, rounds=3)
    with viewer(tmp_path, "one") as url, page_at(browser, url) as page:
        ready(page)
        legend = page.locator(".flock-legend")
        expect(legend).to_be_hidden()  # the arena comes first
        page.get_by_role("button", name="Legend").click()
        expect(legend.get_by_text("dashed rim")).to_be_hidden()  # four plans have four colours
        page.set_viewport_size({"width": 640, "height": 360})  # as a zoom of 200 % makes it
        expect(legend).to_be_hidden()
        page.get_by_role("button", name="Legend").click()
        expect(legend).to_be_visible()
        page.set_viewport_size({"width": 1280, "height": 720})
        expect(legend).to_be_visible()
        page.get_by_role("button", name="Legend").click()
        page.reload()
        ready(page)
        expect(legend).to_be_hidden()  # as the reader left it


def test_pages_fit_narrow_and_low_windows(tmp_path: Path, browser: Browser) -> None:
    for name in ("one", "x" * 120):
        make_record(tmp_path / name / "run.mcap", n=4, rounds=3, agree=name == "one")
    with viewer(tmp_path, "one", "x" * 120) as url:
        for width, height in ((320, 720), (320, 180), (400, 860)):  # the second is 1280 by 720 at a zoom of 400 %
            with page_at(browser, url, width=width, height=height) as page:
                page.locator("tbody tr").first.wait_for()  # the viewer is there
                for path in ("run/2", "pair/1/2", "runs", "cockpit"):
                    go(page, at(url, path))
                    page.locator("canvas[data-round], tbody tr, .flock-shape").first.wait_for()
                    wide = page.evaluate("document.documentElement.scrollWidth")
                    assert wide <= width, (path, width, wide)
                go(page, at(url, "run/1"))
                ready(page)
                expect(page.locator(".flock-legend")).to_be_hidden()
                tops = [page.locator(one).bounding_box() for one in (".flock-banner", ".flock-layers")]
                assert tops[0] and tops[1] and tops[0]["y"] < min(tops[1]["y"], 100), "what came of the run is first"
                bar = page.evaluate("getComputedStyle(document.querySelector('.flock-time')).position")
                assert bar == ("sticky" if height > 560 else "static"), "what stays in sight leaves room for the rest"
                go(page, at(url, "runs"))
                cells = page.locator("tbody tr").first.get_by_role("cell")
                expect(cells).to_have_count(13)
                assert page.get_by_role("link", name="one").evaluate("(at) => at.getBoundingClientRect().height") < 40


def test_a_robot_is_not_compared_with_itself(tmp_path: Path, browser: Browser) -> None:
    make_record(tmp_path / "one" / "run.mcap", n=3, rounds=2)
    with viewer(tmp_path, "one") as url, page_at(browser, url) as page:
        ready(page)
        expect(page.locator(".flock-mind")).to_have_count(1)
        other = page.get_by_label("Compare with")
        other.select_option("0:2")
        expect(page.locator(".flock-mind")).to_have_count(2)
        page.get_by_label("Robot", exact=True).select_option("0:2")
        expect(page.locator(".flock-mind")).to_have_count(1)
        expect(other).to_have_value("")
        assert other.locator("option[disabled]").all_text_contents() == ["2"]


def test_missing_record_is_explained(tmp_path: Path, browser: Browser) -> None:
    record = make_record(tmp_path / "one" / "run.mcap", n=3, rounds=2)
    page = browser.new_page()
    with viewer(tmp_path, "one") as url:
        go(page, at(url, "run/none"))
        expect(page.get_by_role("heading", level=1)).to_have_text("No such run")
        assert page.locator(".flock-card").evaluate("(card) => getComputedStyle(card).borderRadius") == "8px"
        page.get_by_role("link", name="All runs").click()
        page.get_by_role("link", name="one").click()
        ready(page)
        record.unlink()
        page.get_by_role("button", name="Export").click()
        page.get_by_role("button", name="Record (MCAP)").click()
        expect(page.get_by_role("dialog")).to_contain_text("run.mcap is no longer on the disk")
        page.keyboard.press("Escape")
        expect(page.get_by_role("dialog")).to_have_count(0)
    page.get_by_label("Robot", exact=True).select_option("0:2")
    expect(page.get_by_role("tabpanel", name="Mind")).to_contain_text("does not answer: is its command still running?")
    page.close()
