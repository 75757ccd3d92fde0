"""Viewers as a user starts them, and their pages in a real browser."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.client import HTTPConnection
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, Page, Request, expect

RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]


@contextmanager
def viewer(folder: Path, *arguments: str) -> Iterator[str]:
    """A viewer as a user starts it; gives the address that it prints."""
    command = [sys.executable, "-m", "llm_flock", "view", *arguments, "--no-browser", "--port", "0"]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            url = process.stdout.readline().strip()
            assert url.startswith("http://"), process.stderr.read() if process.stderr else ""
            yield url
        finally:
            process.terminate()
            _, errors = process.communicate(timeout=20)
            assert "Traceback" not in errors, errors


def at(url: str, path: str) -> str:
    """The address of another page of the viewer, with the token; numbers stand for its runs, in their order from 1."""
    if re.search(r"/\d", path):
        keys = keys_of(url)
        path = re.sub(r"/(\d+)", lambda found: f"/{keys[int(found[1]) - 1]}", path)
    return url.replace("/?", f"/{path}?")


def keys_of(url: str) -> list[str]:
    """The keys of a viewer's runs, in their order."""
    parts = urlsplit(url)
    token = parts.query.partition("=")[2]
    connection = HTTPConnection(parts.hostname or "", parts.port, timeout=20)
    try:
        connection.request("GET", "/data/runs", headers={"Cookie": f"flock_token_{parts.port}={token}"})
        return [row["key"] for row in json.loads(connection.getresponse().read())["rows"]]
    finally:
        connection.close()


def go(page: Page, url: str) -> None:
    """Open an address with its token, and wait until the page has left it."""
    page.goto(url)
    page.wait_for_url(lambda now: "token=" not in now)


@contextmanager
def page_at(
    browser: Browser, url: str, *, width: int = 1280, height: int = 720, dark: bool = False, still: bool = True
) -> Iterator[Page]:
    """A page that must neither complain, nor ask anybody else, nor give a request up.

    What was asked for by a page that has been left, or loaded again, is given up by the browser: no fault. Where
    it is not `still`, a record plays when it appears.
    """
    context = browser.new_context(
        color_scheme="dark" if dark else "light",
        viewport={"width": width, "height": height},
        reduced_motion="reduce" if still else "no-preference",
        accept_downloads=True,
    )
    page = context.new_page()
    said: list[str] = []
    asked: list[Request] = []
    sockets: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))

    lost: list[Request] = []

    def lose(request: Request) -> None:
        lost.append(request)

    page.on("requestfailed", lose)
    page.on("request", lambda request: asked.append(request))
    page.on("websocket", lambda socket: sockets.append(socket.url))
    go(page, url)
    yield page
    # A page of a run in flight asks on; an unfinished request of a page that is left is no fault.
    page.remove_listener("requestfailed", lose)
    # Told at the end: that a request is given up may be known before the navigation that is its cause.
    for request in lost:
        later = asked[asked.index(request) + 1 :]
        if request.failure != "net::ERR_ABORTED" or not any(other.is_navigation_request() for other in later):
            said.append(f"given up: {request.url} {request.failure}")
    own = re.escape(url.split("/")[2])
    assert said == [], said
    addresses = [*(request.url for request in asked), *sockets]
    assert [address for address in addresses if not re.match(rf"((http|ws)://{own}/|data:|blob:)", address)] == []
    context.close()


def shown_round(page: Page, arena: int = 0) -> int:
    return int(page.locator("main .flock-arena canvas").nth(arena).get_attribute("data-round") or -1)


def until(true: Callable[[], bool], what: str, timeout_s: float = 20.0) -> None:
    end = time.monotonic() + timeout_s
    while not true():
        assert time.monotonic() < end, what
        time.sleep(0.05)


def ready(page: Page) -> None:
    page.locator("main .flock-arena canvas[data-round]").first.wait_for()
    # Keys lead no farther than the rounds that have been read.
    expect(page.locator(".flock-where")).to_contain_text(re.compile("of [1-9]"))


def choose(page: Page, robot: int) -> None:
    page.get_by_label("Robot", exact=True).select_option(f"0:{robot}")
    expect(page.locator(".flock-mind").first).to_contain_text(f"Robot {robot} ·")


def violations(page: Page) -> list[str]:
    """What axe-core finds wrong, in a line each."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed")
    options = {"resultTypes": ["violations"], "runOnly": {"type": "tag", "values": RULES}}
    found: dict[str, Any] = axe.Axe().run(page, options=options).response
    return [
        f"{one['id']}: {one['help']}: {[node['html'][:160] for node in one['nodes'][:4]]}"
        for one in found["violations"]
    ]
