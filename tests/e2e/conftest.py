"""A browser for the tests that need one; a page of a busy machine may take its time."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, expect, sync_playwright

expect.set_options(timeout=20_000)

LONG = (
    "swarm_faults",
    "ros2",
    "cli",
    "viewer",
    "power_lost",
    "three_drones",
    "mavlink_flights",
    "sweep_ray",
    "swarm_cli",
    "sweep",
    "notebooks",
    "report",
    "sweep_stopped",
    "exam",
    "viewer_access",
    "fly_cli",
    "http_run",
    "swarm_orders",
    "swarm_keys",
    "ways",
    "exports",
    "extending",
    "local_engine",
    "viewer_arena",
    "swarm_liar",
    "viewer_swarm",
    "local_runs",
)
"""Modules that take the most time, the longest first: none of them is left when the others have ended."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    turns = {f"test_{name}": turn for turn, name in enumerate(LONG)}
    items.sort(key=lambda item: turns.get(item.path.stem, len(LONG)))


@pytest.fixture(scope="session")
def chromium() -> str:
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        pytest.fail("no browser: install Debian's chromium (apt-get install chromium)", pytrace=False)
    return found


@pytest.fixture(scope="module")
def browser(chromium: str) -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()
