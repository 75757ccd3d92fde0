"""The report of a real sweep in a real browser: no error, no request, and a page that one can read, light and dark."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser
from viewer_pages import violations

SWEEP = """
[sweep]
name = "browser"
seeds = 2

[grid]
team = ["triangle/3"]
protocol = ["flock", "baseline"]
"""


@pytest.fixture(scope="module")
def report(chromium: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Asks for the browser first: where there is none, nothing is flown."""
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "sweep.toml").write_text(SWEEP)
    for arguments in (
        ["sweep", "sweep.toml", "--out", "results", "--quiet", "--jobs", "1"],
        ["report", "results", "--gallery", "2", "--formats", "svg", "--quiet"],
        ["export", "results"],
    ):
        command = [sys.executable, "-m", "llm_flock", *arguments]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr + done.stdout
    assert (folder / "results" / "trials.csv").exists() and (folder / "results" / "report" / "report.md").exists()
    return folder / "results" / "report" / "report.html"


@pytest.mark.parametrize(("width", "scheme"), [(400, "dark"), (1280, "light")])
def test_the_report_opens_without_error_or_request(report: Path, browser: Browser, scheme: str, width: int) -> None:
    dark = scheme == "dark"
    context = browser.new_context(color_scheme="dark" if dark else "light", viewport={"width": width, "height": 900})
    page = context.new_page()
    said: list[str] = []
    asked: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(report.as_uri())
    page.wait_for_load_state("networkidle")
    assert said == []
    assert [url for url in asked if not url.startswith("data:")] == [report.as_uri()]
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.locator("section").count() >= 7 and page.locator("figure svg").count() >= 6
    assert page.locator("img").count() >= 1
    assert page.evaluate("[...document.images].every(image => image.complete && image.naturalWidth > 0)")
    assert page.get_by_text("Simulated language models").is_visible()
    for shown, theme in ((dark, scheme), (not dark, "the other")):
        picture = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("L"))
        # The page is of one brightness, and words of the other stand on it.
        assert bool(np.median(picture) < 60) is shown, theme
        assert np.mean(picture > 128 if shown else picture < 128) > 0.005
        page.locator("#theme").click()
    context.close()


def test_every_figure_is_drawn_in_colours_of_the_page(report: Path, browser: Browser) -> None:
    page = browser.new_page(color_scheme="dark")
    page.goto(report.as_uri())
    for figure in page.locator("figure svg").all():
        picture = np.asarray(Image.open(io.BytesIO(figure.screenshot())).convert("L"))
        assert np.median(picture) < 60 and picture.max() > 150
    page.close()


def test_report_keeps_wcag_rules_and_prints_whole_on_white(report: Path, browser: Browser) -> None:
    page = browser.new_page(color_scheme="dark", viewport={"width": 400, "height": 860})
    page.goto(report.as_uri())
    assert violations(page) == [], "dark, on a phone"
    page.set_viewport_size({"width": 1280, "height": 900})
    page.locator("#theme").click()
    assert violations(page) == [], "light"
    page.locator("#theme").click()
    page.emulate_media(media="print")
    page.set_viewport_size({"width": 700, "height": 900})  # a sheet of paper
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    cut = "[...document.querySelectorAll('table, svg')].filter(one => one.getBoundingClientRect().right > 700).length"
    assert page.evaluate(cut) == 0
    page.close()
