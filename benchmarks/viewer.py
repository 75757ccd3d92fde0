"""What a viewer costs: first paint after the command, scrubbing, and the memory of a tab that watches a live run.

    python benchmarks/viewer.py [paint] [scrub] [live --seconds 600]

Needs the `view` and `dev` extras and a Chromium. Records are made up (`tests/sample_records.py`); no model is asked.
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from playwright.sync_api import Browser, Page, sync_playwright
from sample_records import FakeRun, make_record

from llm_flock.record.writer import RecordWriter

STARTS = 5
JUMPS = 60


@contextmanager
def viewer(*arguments: str) -> Iterator[tuple[str, float]]:
    """A viewer, and when its command was given."""
    command = [sys.executable, "-m", "llm_flock", "view", *arguments, "--no-browser", "--port", "0"]
    began = time.time()
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().strip(), began
        finally:
            process.terminate()


def opened(browser: Browser, url: str) -> Page:
    page = browser.new_page(viewport={"width": 1280, "height": 720})
    page.goto(url, timeout=60_000)
    page.locator(".flock-arena canvas[data-round]").wait_for(timeout=60_000)
    return page


def paint(browser: Browser, folder: Path) -> None:
    record = make_record(folder / "paint" / "run.mcap", n=10, rounds=60)
    first: list[float] = []
    arena: list[float] = []
    for _ in range(STARTS):
        with viewer(str(record)) as (url, began):
            page = browser.new_page(viewport={"width": 1280, "height": 720})
            painted: list[float] = []
            page.expose_function("painted", lambda at, painted=painted: painted.append(at))
            page.add_init_script(
                """new PerformanceObserver((list) => {
                    for (const entry of list.getEntriesByName("first-contentful-paint")) {
                        window.painted(performance.timeOrigin + entry.startTime);
                    }
                }).observe({ type: "paint", buffered: true });"""
            )
            page.goto(url, timeout=60_000)
            page.locator(".flock-arena canvas[data-round]").wait_for(timeout=60_000)
            arena.append(time.time() - began)
            first.append(painted[0] / 1000 - began)
            page.close()
    print(f"first paint after the command: median {statistics.median(first):.2f} s, worst {max(first):.2f} s")
    print(f"arena drawn after the command: median {statistics.median(arena):.2f} s, worst {max(arena):.2f} s")


def scrub(browser: Browser, folder: Path) -> None:
    record = make_record(folder / "scrub" / "run.mcap", n=20, rounds=1000)
    with viewer(str(record)) as (url, _):
        page = opened(browser, url)
        page.wait_for_function("flockClock('main').last === 1000", timeout=60_000)
        took = page.evaluate(
            """async (jumps) => {
                const clock = flockClock("main");
                const arena = document.querySelector(".flock-arena canvas");
                const took = [];
                for (let k = 0; k < jumps; k += 1) {
                    const round = (k * 617) % 1001;  // far from one another: nothing is at hand at first
                    const began = performance.now();
                    clock.seek(round);
                    while (arena.dataset.round !== String(round)) await new Promise(requestAnimationFrame);
                    took.push(performance.now() - began);
                    await new Promise((done) => setTimeout(done, 30));
                }
                return took;
            }""",
            JUMPS,
        )
        page.close()
    took.sort()
    print(
        f"scrub, 20 robots, 1000 rounds: median {took[len(took) // 2]:.0f} ms, worst {took[-1]:.0f} ms of {JUMPS} jumps"
    )


def frames(browser: Browser, folder: Path, n: int) -> None:
    record = make_record(folder / f"frames-{n}" / "run.mcap", n=n, rounds=60, llm=False)
    with viewer(str(record)) as (url, _):
        page = opened(browser, url)
        page.wait_for_function("flockClock('main').last === 60", timeout=60_000)
        drawn = page.evaluate(
            """async () => {
                const clock = flockClock("main");
                clock.seek(0); clock.speed = 8; clock.toggle();
                const before = Number(document.querySelector(".flock-arena canvas").dataset.drawn);
                const began = performance.now();
                await new Promise((done) => setTimeout(done, 5000));
                const after = Number(document.querySelector(".flock-arena canvas").dataset.drawn);
                return (after - before) / (performance.now() - began) * 1000;
            }"""
        )
        page.close()
    print(f"{n} robots: {drawn:.0f} pictures a second while it plays")


def live(browser: Browser, folder: Path, seconds: float, rate: float) -> None:
    path = folder / "live" / "run.mcap"
    fake = FakeRun(n=20, rounds=10)
    with RecordWriter(path) as writer:
        fake.rounds = 1
        fake.write(writer, finish=False)
        fake.rounds = int(seconds * rate)
        with viewer(str(path), "--live") as (url, _):
            page = opened(browser, url)
            tab = page.context.new_cdp_session(page)
            began, told, number = time.monotonic(), 0.0, 1
            sizes: list[float] = []
            while (now := time.monotonic() - began) < seconds:
                while number < now * rate:
                    number += 1
                    fake.write_round(writer, number)
                if now >= told:
                    told += seconds / 10
                    tab.send("HeapProfiler.collectGarbage")
                    sizes.append(tab.send("Runtime.getHeapUsage")["usedSize"] / 1e6)
                    print(f"  {now:5.0f} s, round {number}: heap {sizes[-1]:.1f} MB", flush=True)
                time.sleep(0.05)
            shown = int(page.locator(".flock-arena canvas").get_attribute("data-round") or -1)
            page.close()
    print(f"live, 20 robots, {rate:g} rounds/s for {seconds:g} s: heap {sizes[1]:.1f} -> {sizes[-1]:.1f} MB;")
    print(f"  at the end the arena was {number - shown} rounds behind the record")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("what", nargs="*", default=["paint", "scrub", "frames", "live"])
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--rate", type=float, default=10.0)
    asked = parser.parse_args()
    chromium = shutil.which("chromium")
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        folder = Path(name)
        if "paint" in asked.what:
            paint(browser, folder)
        if "scrub" in asked.what:
            scrub(browser, folder)
        if "frames" in asked.what:
            for n in (100, 1000):
                frames(browser, folder, n)
        if "live" in asked.what:
            live(browser, folder, asked.seconds, asked.rate)
        browser.close()


if __name__ == "__main__":
    main()
