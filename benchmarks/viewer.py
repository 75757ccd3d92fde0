"""What a viewer costs: first paint, scrubbing, playing, and the memory of a tab that watches a live run.

    python benchmarks/viewer.py [paint] [scrub] [frames] [live --seconds 600]

Needs the `view` and `dev` extras and a Chromium. Records are made up (`tests/sample_records.py`); no model is asked.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from playwright.sync_api import Browser, Page, sync_playwright
from sample_records import FakeRun, make_record

from llm_flock.record._writer import RecordWriter

STARTS = 5
JUMPS = 60
LOOKS = 20
"""At the heap of a tab, over the time of a live run."""

STEADY = 0.25
"""A heap that grows by less is steady [MB a minute]."""


class Start(NamedTuple):
    """A viewer that has printed its address, and when its command was given."""

    url: str
    began: float
    process: int

    def processor_s(self) -> float | None:
        """Processor time of the viewer by now, which other programs change little; None where the system hides it."""
        try:
            fields = Path(f"/proc/{self.process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        except OSError:
            return None
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def viewer(*arguments: str) -> Iterator[Start]:
    """A viewer that runs."""
    command = [sys.executable, "-m", "llm_flock", "view", *arguments, "--no-browser", "--port", "0"]
    # An installed package has byte code: what is compiled at the first start is kept for the others.
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    began = time.time()
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=kept) as process:
        assert process.stdout is not None
        try:
            yield Start(process.stdout.readline().strip(), began, process.pid)
        finally:
            process.terminate()


def opened(browser: Browser, url: str) -> Page:
    page = browser.new_page(viewport={"width": 1280, "height": 720}, reduced_motion="reduce")
    page.goto(url, timeout=60_000)
    page.locator("main .flock-arena canvas[data-round]").wait_for(timeout=60_000)
    return page


def reached(page: Page, rounds: int) -> None:
    """Wait until the page knows of this many rounds. Its policy forbids what Playwright's own waiting does."""
    while page.evaluate("flockClock().last") < rounds:
        time.sleep(0.02)


SEEN = """
const tell = (what) => window.seen(what, performance.timeOrigin + performance.now());
new PerformanceObserver((list) => {
    for (const entry of list.getEntriesByName("first-contentful-paint")) {
        window.seen("paint", performance.timeOrigin + entry.startTime);
    }
}).observe({ type: "paint", buffered: true });
const wanted = {
    arena: ".flock-arena canvas[data-round]",
    page: "main .flock-headline:not(:empty)",
    words: "main .flock-mind",
};
const look = () => {
    for (const [what, where] of Object.entries(wanted)) {
        if (!document.querySelector(where)) continue;
        delete wanted[what];
        // What was drawn in one frame is on the screen with the next one.
        requestAnimationFrame(() => tell(what));
    }
    if (Object.keys(wanted).length) requestAnimationFrame(look);
};
requestAnimationFrame(look);
"""
"""Tells when something is first seen, in every page that is loaded."""

PAINTS = {
    "paint": "first paint (the page's frame)",
    "arena": "arena of the record drawn",
    "page": "whole page, with what came of the run",
    "words": "the mind of a robot beside it",
}


def paint(browser: Browser, folder: Path) -> None:
    record = make_record(folder / "paint" / "run.mcap", n=10, rounds=60)
    after: dict[str, list[float]] = {what: [] for what in PAINTS}
    printed: list[float] = []
    used: list[float | None] = []
    whole: list[float | None] = []
    with viewer(str(record)):
        pass  # as after an installation, nothing has to be compiled
    for _ in range(STARTS):
        # The browser is there before the command, as a user's is; it is the viewer that is timed.
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        seen: dict[str, float] = {}
        page.expose_function("seen", lambda what, at, seen=seen: seen.setdefault(what, at))
        page.add_init_script(SEEN)
        with viewer(str(record)) as start:
            used.append(start.processor_s())
            printed.append(time.time() - start.began)
            page.goto(start.url, timeout=60_000)
            page.locator("main .flock-mind").first.wait_for(timeout=60_000)
            whole.append(start.processor_s())
            page.wait_for_timeout(300)  # what was seen is told
            for what, times in after.items():
                times.append(seen[what] / 1000 - start.began)
        page.close()
    print("after the command, 10 robots, 60 rounds:")
    for what, times in (
        {"its address printed": printed} | {PAINTS[what]: times for what, times in after.items()}
    ).items():
        print(f"  {what}: median {statistics.median(times):.2f} s, worst {max(times):.2f} s of {STARTS}")
    for what, spent in (("address", used), ("mind of a robot", whole)):
        known = [one for one in spent if one is not None]
        if known:
            print(f"  processor time of the viewer until its {what}: median {statistics.median(known):.2f} s")


def scrub(browser: Browser, folder: Path) -> None:
    record = make_record(folder / "scrub" / "run.mcap", n=20, rounds=1000)
    with viewer(str(record)) as start:
        page = opened(browser, start.url)
        reached(page, 1000)
        took = page.evaluate(
            """async (jumps) => {
                const clock = flockClock();
                const arena = document.querySelector("main .flock-arena canvas");
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
    with viewer(str(record)) as start:
        page = opened(browser, start.url)
        reached(page, 60)
        drawn = page.evaluate(
            """async () => {
                const clock = flockClock();
                clock.seek(0); clock.speed = 8; clock.toggle();
                const before = Number(document.querySelector("main .flock-arena canvas").dataset.drawn);
                const began = performance.now();
                await new Promise((done) => setTimeout(done, 5000));
                const after = Number(document.querySelector("main .flock-arena canvas").dataset.drawn);
                return (after - before) / (performance.now() - began) * 1000;
            }"""
        )
        page.close()
    print(f"{n} robots: {drawn:.0f} pictures a second while it plays at 8 rounds a second")


def live(browser: Browser, folder: Path, seconds: float, rate: float) -> None:
    path = folder / "live" / "run.mcap"
    fake = FakeRun(n=20, rounds=10)
    with RecordWriter(path) as writer:
        fake.rounds = 1
        fake.write(writer, finish=False)
        fake.rounds = int(seconds * rate)
        with viewer(str(path), "--live") as start:
            page = opened(browser, start.url)
            tab = page.context.new_cdp_session(page)
            began, told, number = time.monotonic(), 0.0, 1
            sizes: list[tuple[float, float]] = []
            while (now := time.monotonic() - began) < seconds:
                while number < now * rate:
                    number += 1
                    fake.write_round(writer, number)
                if now >= told:
                    told += seconds / LOOKS
                    tab.send("HeapProfiler.collectGarbage")
                    sizes.append((now, tab.send("Runtime.getHeapUsage")["usedSize"] / 1e6))
                    print(f"  {now:5.0f} s, round {number}: heap {sizes[-1][1]:.1f} MB", flush=True)
                time.sleep(0.05)
            shown = int(page.locator("main .flock-arena canvas").get_attribute("data-round") or -1)
            page.close()
    print(f"live, 20 robots, {rate:g} rounds/s for {seconds:g} s: heap {sizes[1][1]:.1f} -> {sizes[-1][1]:.1f} MB;")
    print(f"  {growth(sizes)}; at the end the arena was {number - shown} rounds behind the record")


def growth(sizes: list[tuple[float, float]]) -> str:
    """Whether a heap is steady: how fast it grew in the first half of the time and in the second."""
    halves = sizes[1 : len(sizes) // 2 + 1], sizes[len(sizes) // 2 :]
    one, two = (60 * statistics.linear_regression(*zip(*half, strict=True)).slope for half in halves)
    steady = "steady" if abs(two) < STEADY else "not steady (yet)"
    return f"{one:+.2f} MB a minute in the first half, {two:+.2f} in the second: {steady}"


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
