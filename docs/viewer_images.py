"""Takes the pictures of docs/how-to/viewer.md: `python docs/viewer_images.py [FOLDER]`, with extras `view` and `dev`.

Every model in them is simulated. A real browser opens a real viewer; the pictures are reduced to 256 colours.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, ViewportSize, expect, sync_playwright

COLOURS = 256
DESKTOP, PHONE = (1280, 720), (400, 860)
MODEL = "simulated:distorted@0.2,overshoot@0.3,malformed@0.15"
BAD = "3=simulated:malformed,0-2=simulated:ideal,4-5=simulated:ideal"
NOT_FORMED = [
    "run",
    "--robots",
    "6",
    "--shape",
    "circle",
    "--seed",
    "2",
    "--model",
    BAD,
    "--fallback",
    "hold",
    "--rounds",
    "40",
]
RUN = ["run", "--robots", "12", "--shape", "circle", "--seed", "4", "--model", MODEL, "--start", "connected", "--quiet"]


@contextmanager
def viewer(folder: Path, *arguments: str) -> Iterator[str]:
    command = [sys.executable, "-m", "llm_flock", "view", *arguments, "--no-browser", "--port", "0"]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().strip()
        finally:
            process.terminate()


def at(url: str, path: str) -> str:
    """The address of another page of the viewer, with the token."""
    return url.replace("/?", f"/{path}?")


def page_of(browser: Browser, size: tuple[int, int] = DESKTOP, *, dark: bool = False) -> Page:
    scheme = "dark" if dark else "light"
    window = ViewportSize(width=size[0], height=size[1])
    # Without this a record would play on while its picture is taken.
    return browser.new_page(viewport=window, color_scheme=scheme, reduced_motion="reduce")


def reached(page: Page, number: int) -> None:
    """Wait until the page knows of a round. Its policy forbids what Playwright's own waiting does."""
    while not page.evaluate(f"globalThis.flockClock ? flockClock().last >= {number} : false"):
        page.wait_for_timeout(50)


def replay(page: Page, url: str, number: int) -> None:
    page.goto(url)
    seek(page, number)


def seek(page: Page, number: int) -> None:
    page.locator("main .flock-arena canvas[data-round]").first.wait_for()
    reached(page, number)
    page.evaluate(f"flockClock().seek({number})")
    expect(page.locator(".flock-where")).to_contain_text(f"round {number} ")


def select(page: Page, *robots: int) -> None:
    for label, robot in zip(("Robot", "Compare with"), robots, strict=False):
        page.get_by_label(label, exact=True).select_option(f"0:{robot}")
    expect(page.locator(".flock-mind")).to_have_count(len(robots))


def save(page: Page, folder: Path, name: str, *, whole: bool = False) -> None:
    page.mouse.move(2, 2)
    page.wait_for_timeout(700)  # menus and marks fade
    path = folder / f"viewer-{name}.png"
    page.screenshot(path=path, full_page=whole)
    Image.open(path).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    print(path)
    page.close()


def pictures_of_a_record(browser: Browser, url: str, out: Path) -> None:
    for dark in (False, True):
        page = page_of(browser, dark=dark)
        replay(page, url, 3)
        select(page, 5)
        page.get_by_role("checkbox", name="Voronoi cells").check()
        save(page, out, "mind-dark" if dark else "mind")
    page = page_of(browser)
    replay(page, url, 2)
    select(page, 5, 7)
    save(page, out, "compare")
    page = page_of(browser)
    replay(page, url, 5)
    page.get_by_role("tab", name="Plots").click()
    save(page, out, "plots")
    page = page_of(browser)
    replay(page, url, 4)
    page.get_by_role("tab", name="Events").click()
    save(page, out, "events")
    page = page_of(browser, PHONE)
    replay(page, url, 4)
    select(page, 5)
    save(page, out, "phone", whole=True)


def pictures_of_the_cockpit(browser: Browser, url: str, out: Path) -> None:
    for name, size in (("cockpit", DESKTOP), ("cockpit-phone", PHONE)):
        page = page_of(browser, size)
        page.goto(at(url, "cockpit"))
        page.get_by_role("button", name="Start", exact=True).wait_for()
        save(page, out, name, whole=size is PHONE)
    page = page_of(browser)
    page.goto(at(url, "cockpit"))
    page.get_by_label("Rounds a second").fill("10")
    page.get_by_label("Rounds at most").fill("60")
    page.get_by_role("button", name="Paper against flock").click()
    page.wait_for_url("**/pair/**")
    reached(page, 20)
    page.get_by_role("button", name="Kill").click()
    reached(page, 34)
    page.get_by_role("tab", name="Plots").click()
    save(page, out, "pair")


def pictures_of_runs(browser: Browser, url: str, out: Path) -> None:
    page = page_of(browser)
    page.goto(at(url, "runs"))
    page.locator("tbody tr").first.wait_for()
    for box in page.locator("tbody input").all():
        box.check()
    save(page, out, "runs")
    page = page_of(browser)
    page.goto(at(url, "runs"))
    page.get_by_role("link", name="not-formed", exact=True).click()
    seek(page, 9)
    save(page, out, "not-formed")


def main() -> None:
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "images"
    chromium = shutil.which("chromium")
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        folder = Path(name)
        for run, where in ((RUN, "circle"), ([*NOT_FORMED, "--quiet"], "not-formed")):
            command = [sys.executable, "-m", "llm_flock", *run, "--out", where]
            subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        with viewer(folder, "circle") as url:
            pictures_of_a_record(browser, url, out)
            pictures_of_the_cockpit(browser, url, out)
        with viewer(folder, "circle", "not-formed") as url:
            pictures_of_runs(browser, url, out)
        browser.close()


if __name__ == "__main__":
    main()
