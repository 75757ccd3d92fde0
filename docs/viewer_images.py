"""Takes the pictures of docs/how-to/viewer.md: `python docs/viewer_images.py [FOLDER]`, with extras `view` and `dev`.

Every model in them is simulated. A real browser opens a real viewer; the pictures are reduced to 128 colours.
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
from playwright.sync_api import Browser, Page, expect, sync_playwright

COLOURS = 128
DESKTOP, PHONE = (1280, 720), (400, 860)
MODEL = "simulated:distorted@0.2,overshoot@0.3,malformed@0.15"
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


def page_of(browser: Browser, size: tuple[int, int] = DESKTOP, *, dark: bool = False) -> Page:
    scheme = "dark" if dark else "light"
    return browser.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme=scheme)


def replay(page: Page, url: str, number: int) -> None:
    page.goto(url)
    page.locator("#app .flock-arena canvas[data-round]").first.wait_for()
    page.wait_for_function(f"flockClock('main').last >= {number}")
    page.evaluate(f"flockClock('main').seek({number})")
    expect(page.locator(".flock-where")).to_contain_text(f"round {number} ")


def select(page: Page, *robots: int) -> None:
    for number, (label, robot) in enumerate(zip(("Robot", "Compare with"), robots, strict=False), 1):
        page.get_by_label(label, exact=True).click()
        page.get_by_role("option", name=str(robot), exact=True).click()
        # A menu that is still closing takes the next click, or the cursor, back to its own field.
        expect(page.locator(".q-menu")).to_have_count(0)
        expect(page.locator(".flock-mind")).to_have_count(number)


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
        page.get_by_role("checkbox", name="Voronoi cells").click()
        save(page, out, "mind-dark" if dark else "mind")
    page = page_of(browser)
    replay(page, url, 2)
    select(page, 5, 7)
    save(page, out, "compare")
    for dark in (False, True):
        page = page_of(browser, dark=dark)
        replay(page, url, 5)
        page.get_by_role("tab", name="Plots").click()
        save(page, out, "plots-dark" if dark else "plots")
    page = page_of(browser)
    replay(page, url, 4)
    page.get_by_role("tab", name="Events").click()
    save(page, out, "events")
    page = page_of(browser, PHONE)
    replay(page, url, 4)
    select(page, 5)
    save(page, out, "phone", whole=True)


def pictures_of_the_cockpit(browser: Browser, url: str, out: Path) -> None:
    for name, size, dark in (
        ("cockpit", DESKTOP, False),
        ("cockpit-dark", DESKTOP, True),
        ("cockpit-phone", PHONE, False),
    ):
        page = page_of(browser, size, dark=dark)
        page.goto(f"{url}cockpit")
        page.get_by_role("button", name="Start", exact=True).wait_for()
        save(page, out, name, whole=size is PHONE)
    page = page_of(browser)
    page.goto(f"{url}cockpit")
    page.get_by_label("Rounds a second").fill("10")
    page.get_by_label("Rounds at most").fill("60")
    page.get_by_role("button", name="Paper against flock").click()
    page.wait_for_function("globalThis.flockClock && flockClock('main').last >= 20", timeout=60_000)
    page.get_by_label("Robot", exact=True).first.wait_for()
    page.get_by_role("button", name="Kill").click()
    page.wait_for_function("flockClock('main').last >= 34", timeout=60_000)
    page.screenshot()
    save(page, out, "pair")
    page = page_of(browser, dark=True)
    page.goto(f"{url}runs")
    page.get_by_role("link", name="Cockpit").wait_for()
    save(page, out, "runs")


def main() -> None:
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "images"
    chromium = shutil.which("chromium")
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        folder = Path(name)
        subprocess.run(
            [sys.executable, "-m", "llm_flock", *RUN, "--out", "circle"],
            cwd=folder,
            check=True,
            stdout=subprocess.DEVNULL,
        )
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        with viewer(folder, "circle") as url:
            pictures_of_a_record(browser, url, out)
            pictures_of_the_cockpit(browser, url, out)
        browser.close()


if __name__ == "__main__":
    main()
