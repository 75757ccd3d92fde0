"""The viewer with a keyboard, and by the rules of WCAG 2.2 AA as axe-core checks them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect
from sample_records import make_record
from viewer_pages import at, go, page_at, ready, shown_round, until, viewer, violations

FOCUS = """() => {
    const at = document.activeElement;
    const shown = getComputedStyle(at);
    const box = at.getBoundingClientRect();
    return [at.tagName + " " + (at.getAttribute("aria-label") || at.textContent || at.id).slice(0, 40),
        shown.outlineStyle !== "none" && parseFloat(shown.outlineWidth) >= 2, box.width > 0 && box.height > 0];
}"""


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("access")
    for name, agree in (("one", True), ("other", False)):
        make_record(folder / name / "run.mcap", n=5, rounds=6, agree=agree)
    with viewer(folder, "one", "other") as url:
        yield url


@pytest.mark.parametrize("dark", [False, True])
def test_pages_keep_the_rules_of_wcag(served: str, browser: Browser, dark: bool) -> None:
    with page_at(browser, at(served, "run/1"), dark=dark) as page:
        ready(page)
        page.keyboard.press("End")
        expect(page.locator(".flock-mind")).to_contain_text("round 6")
        assert violations(page) == []
        for tab in ("Plots", "Events"):
            page.get_by_role("tab", name=tab).click()
            assert violations(page) == [], tab
        page.keyboard.press("?")
        assert violations(page) == [], "the list of keys"
        for path in ("pair/1/2", "runs", "cockpit"):
            go(page, at(served, path))
            page.locator(".flock-headline:not(:empty), tbody tr, .flock-shape").first.wait_for()
            assert violations(page) == [], path
        page.set_viewport_size({"width": 400, "height": 860})
        for path in ("run/2", "pair/1/2", "runs", "cockpit"):
            go(page, at(served, path))
            page.locator(".flock-headline:not(:empty), tbody tr, .flock-shape").first.wait_for()
            assert violations(page) == [], f"{path} on a phone"
        page.evaluate("document.body.append(document.createElement('button'))")
        assert any("button-name" in line for line in violations(page)), "the checker checks"


def test_every_control_is_reached_by_keyboard_and_shows_focus(served: str, browser: Browser) -> None:
    for path in ("run/1", "runs", "cockpit"):
        with page_at(browser, at(served, path)) as page:
            page.locator(".flock-mind, tbody tr, .flock-shape").first.wait_for()
            reached: list[str] = []
            for _ in range(60):
                page.keyboard.press("Tab")
                name, ringed, seen = page.evaluate(FOCUS)
                if name.startswith("BODY") or name in reached[:1]:
                    break
                reached.append(name)
                # The ring of a hidden radio button is drawn around its picture.
                assert (ringed and seen) or page.locator(":focus-visible").count(), (path, name)
            assert len(reached) >= 6, (path, reached)


def test_the_question_mark_lists_the_keys_and_they_work(served: str, browser: Browser) -> None:
    with page_at(browser, at(served, "run/1")) as page:
        ready(page)
        page.keyboard.press("?")
        keys = page.get_by_role("dialog", name="Keys")
        expect(keys).to_contain_text("one round back, one round on")
        page.keyboard.press("ArrowRight")
        assert shown_round(page) == 0, "keys of the page rest while a dialog is open"
        page.keyboard.press("Escape")
        expect(keys).to_have_count(0)
        page.keyboard.press("ArrowRight")
        until(lambda: shown_round(page) == 1, "one round on")
        page.keyboard.press("]")
        expect(page.locator(".flock-mind").first).to_contain_text("round 1")
        legend = page.locator(".flock-legend")
        expect(legend).to_be_hidden()
        page.keyboard.press("l")
        expect(legend).to_be_visible()
        page.reload()
        ready(page)
        expect(legend).to_be_visible()
        scale = "flockClock() && [...document.querySelectorAll('main .flock-arena canvas')][0].dataset.scale"
        before = page.evaluate(scale)
        for key in ("f", "a", "0", "+"):
            page.keyboard.press(key)
            page.wait_for_timeout(60)
        assert page.evaluate(scale) != before


def test_a_run_is_started_and_steered_by_keyboard_alone(tmp_path: Path, browser: Browser) -> None:
    def go_to(page: Page, name: str) -> None:
        for _ in range(60):
            page.keyboard.press("Tab")
            if page.evaluate("document.activeElement.textContent") == name:
                return
        pytest.fail(f"Tab never reached {name}")

    with viewer(tmp_path) as url, page_at(browser, at(url, "cockpit")) as page:
        page.locator(".flock-shape").first.wait_for()
        go_to(page, "Start")
        page.keyboard.press("Enter")
        page.wait_for_url("**/run/**")
        ready(page)
        assert violations(page) == [], "the tab Steer"
        go_to(page, "Kill")
        page.keyboard.press("Enter")
        expect(page.locator(".flock-steered")).to_contain_text("Robot 0 dies")
        expect(page.get_by_role("button", name="Kill")).to_be_disabled()
        assert violations(page) == [], "with a button that is off"
        page.keyboard.press("Shift+Tab")
        assert page.evaluate("document.activeElement.tagName") == "SELECT", "the place is kept"
