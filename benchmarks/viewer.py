"""What a viewer costs: first paint, scrubbing, playing, a class that watches, and the memory of a tab of a live run.

    python benchmarks/viewer.py [paint] [scrub] [frames] [class] [live --seconds 600]

Needs the `view` and `dev` extras and a Chromium. Records are made up (`tests/sample_records.py`), but for the class,
which watches a run of *simulated* models.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple
from urllib.parse import urlsplit

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from playwright.sync_api import Browser, Page, sync_playwright
from sample_records import FakeRun, make_record

from llm_flock.record._writer import RecordWriter

STARTS = 5
JUMPS = 60
PICTURES = 60
CLASS, LESSON, PACE = 30, 60, 4
"""Clients of a class, rounds of the run that it watches, and how many of them are flown a second, as in the form."""

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


def frames(browser: Browser, folder: Path, n: int, dim: int) -> None:
    record = make_record(folder / f"frames-{n}-{dim}" / "run.mcap", n=n, rounds=60, llm=False, dim=dim)
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
        tab = page.context.new_cdp_session(page)
        tab.send("Performance.enable", {"timeDomain": "threadTicks"})
        spent: list[float] = []
        for _ in range(3):  # the first pictures are drawn by scripts that are not compiled yet
            page.evaluate(
                """async (pictures) => {
                    const clock = flockClock();
                    for (let k = 0; k < pictures; k += 1) {
                        clock.seek(clock.last * k / pictures);
                        await new Promise(requestAnimationFrame);
                    }
                }""",
                PICTURES,
            )
            told = tab.send("Performance.getMetrics")["metrics"]
            spent.append(next(one["value"] for one in told if one["name"] == "ScriptDuration"))
        page.close()
    where = "in space" if dim > 2 else "in the plane"
    print(f"{n} robots {where}: {drawn:.0f} pictures a second while it plays at 8 rounds a second,")
    print(f"  {1000 * (spent[2] - spent[1]) / PICTURES:.1f} ms of processor time in scripts each")


class Client(Thread):
    """Asks what a page asks for, and when it does; keeps when each round came, and its robots."""

    def __init__(self, url: str) -> None:
        super().__init__()
        parts = urlsplit(url)
        self.host = parts.netloc
        self.cookie = f"flock_token_{parts.port}={parts.query.partition('=')[2]}"
        self.line = HTTPConnection(self.host, timeout=60)
        self.data = ""
        self.came: dict[int, float] = {}
        self.robots: dict[int, object] = {}

    def ask(self, path: str, order: object = None) -> Any:
        heads = {"Cookie": self.cookie, "Content-Type": "application/json", "Origin": f"http://{self.host}"}
        self.line.request("POST" if order else "GET", path, json.dumps(order) if order else None, heads)
        answer = self.line.getresponse()
        text = answer.read()
        assert answer.status == 200, text
        return json.loads(text)

    def run(self) -> None:
        plans, last, going = 0, -1, True
        while going:
            began = time.monotonic()
            news = self.ask(f"{self.data}/news?rounds={last + 1}&plans={plans}&missions=0")
            plans, going = plans + len(news["plans"]), news["open"]
            if news["last"] > last:
                last = news["last"]
                first = max(0, last - 63, max(self.robots, default=-1) + 1)
                for frame in self.ask(f"{self.data}/frames?first={first}&count=64"):
                    self.came.setdefault(frame["r"], time.monotonic())
                    self.robots.setdefault(frame["r"], frame)
                self.ask(f"{self.data}/mind?robot=0&round={last}")
            time.sleep(max(0.01, began + 0.1 - time.monotonic()))


def lesson(browser: Browser, folder: Path) -> None:
    """A class watches a run that the cockpit starts, two of it in browsers, as docs/how-to/classroom.md has it."""
    fields = {"model": "simulated:distorted@0.3,overshoot@0.3", "rounds": LESSON, "stop_when_formed": False}
    with viewer("--host", "0.0.0.0", "--runs", str(folder / "lesson")) as start:
        clients = [Client(start.url) for _ in range(CLASS)]
        began = start.processor_s()
        run = clients[0].ask("/order", {"order": "start", "pace": PACE, "fields": fields})["address"].split("/")[-1]
        for client in clients:
            client.data = f"/data/{run}"
            client.start()
        pages = [opened(browser, start.url.replace("/?", f"/run/{run}?")) for _ in range(2)]
        for client in clients:
            client.join()
        used = start.processor_s()
        for page in pages:
            reached(page, LESSON)
            page.locator(f'main .flock-arena canvas[data-round="{LESSON}"]').wait_for()
            page.close()
    seen = [client.robots for client in clients]
    same = all(one.get(k, frame) == frame for whole in seen for k, frame in whole.items() for one in seen)
    missed = sum(k not in one for one in seen for k in range(LESSON + 1))
    ended = all(LESSON in one for one in seen)
    times = [[one.came[k] for one in clients if k in one.came] for k in range(1, LESSON + 1)]
    late = sorted(max(came) - min(came) for came in times)
    print(f"{CLASS} clients and 2 pages watch {LESSON} rounds, {PACE} a second: all see the end: {ended}; all see the")
    print(f"  same: {same}; rounds passed over: {missed} of {CLASS * (LESSON + 1)}")
    print(f"  the last client has a round {late[len(late) // 2]:.2f} s after the first, at worst {late[-1]:.2f} s")
    print(f"  the run took {max(times[-1]) - min(times[0]):.1f} s")
    if began is not None and used is not None:
        print(f"  processor time of the viewer, which also flies the run: {used - began:.1f} s")


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
    parser.add_argument("what", nargs="*", default=["paint", "scrub", "frames", "class", "live"])
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
            for n, dim in ((100, 2), (100, 3), (1000, 2)):
                frames(browser, folder, n, dim)
        if "class" in asked.what:
            lesson(browser, folder)
        if "live" in asked.what:
            live(browser, folder, asked.seconds, asked.rate)
        browser.close()


if __name__ == "__main__":
    main()
