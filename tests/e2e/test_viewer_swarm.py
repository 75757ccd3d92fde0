"""The viewer watches a running swarm of processes, and gives it another mission."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from playwright.sync_api import expect, sync_playwright
from viewer_pages import until

from llm_flock_swarm._network.swarm import free_port

TEAM = """
[mission]
shape = "triangle"
n_robots = 3

[model]
model = "simulated:ideal"

[trial]
start = "connected"
seed = 1

[network]
connect = "tcp/127.0.0.1:{port}"
step_s = 0.3
max_s = 90.0
"""


def start(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "llm_flock", *arguments]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)


def test_a_swarm_is_watched_and_given_another_mission(tmp_path: Path) -> None:
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.fail("no browser: install Debian's chromium (apt-get install chromium)", pytrace=False)
    (tmp_path / "team.toml").write_text(TEAM.format(port=free_port()))
    processes = [start(tmp_path, "world", "--config", "team.toml")]
    processes += [start(tmp_path, "robot", "--config", "team.toml", "--id", str(k)) for k in range(3)]
    view = start(tmp_path, "view", "--config", "team.toml", "--no-browser", "--port", "0")
    try:
        assert view.stdout is not None
        url = view.stdout.readline().strip()
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
            page = browser.new_page()
            said: list[str] = []
            page.on("console", lambda message: said.append(message.text))
            page.goto(url)
            page.locator("main .flock-arena canvas[data-round]").wait_for(timeout=60_000)
            expect(page.locator(".flock-state")).to_contain_text("live")
            expect(page.get_by_text("simulated language models")).to_be_visible()
            until(lambda: page.evaluate("flockClock().runs[0].plans.length > 0"), "a plan is known", 60.0)
            page.get_by_label("Shape", exact=True).fill("polygon:3")
            page.get_by_role("button", name="Give the mission").click()
            expect(page.locator(".flock-steered")).to_have_text(re.compile("Robot \\d has the mission"), timeout=20_000)
            other = "flockClock().runs[0].missions.some((one) => one.text.startsWith('polygon'))"
            until(lambda: page.evaluate(other), "the other mission is recorded", 30.0)
            assert said == [], said
            browser.close()
    finally:
        for process in (view, *processes):
            process.terminate()
        for process in (view, *processes):
            process.communicate(timeout=20)
