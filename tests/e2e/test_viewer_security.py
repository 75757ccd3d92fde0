"""A viewer on the network: its token, foreign pages, files, and keys of models."""

from __future__ import annotations

import http.client
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote, unquote, urlsplit

import pytest
from playwright.sync_api import Browser
from sample_records import make_record
from viewer_pages import keys_of, until

from llm_flock_view._viewer.routes import Routes

STARTING = 503
SECRET = "sk-this-must-never-leave-the-server"


@pytest.fixture(scope="module", params=["127.0.0.1", "0.0.0.0"])
def served(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Iterator[str]:
    """The address of a viewer, with a key of a provider in its environment."""
    folder = tmp_path_factory.mktemp("secure")
    (folder / "secret.txt").write_text(SECRET)
    make_record(folder / "one" / "run.mcap", n=3, rounds=2)
    make_record(folder / "other" / "run.mcap", n=3, rounds=2)
    arguments = ["one", "--no-browser", "--host", request.param, "--port", "0", "--model", "openai:gpt-5"]
    command = [sys.executable, "-m", "llm_flock", "view", *arguments]
    environment = {**os.environ, "OPENAI_API_KEY": SECRET}
    with subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            url = process.stdout.readline().strip()
            while get(url, "/")[0] == STARTING:
                time.sleep(0.1)
            yield url
        finally:
            process.terminate()


def get(url: str, path: str, **headers: str) -> tuple[int, dict[str, str], bytes]:
    parts = urlsplit(url)
    assert parts.hostname is not None
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=20)
    try:
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        return answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()
    finally:
        connection.close()


@pytest.fixture(scope="module")
def cookie(served: str) -> str:
    status, headers, _ = get(served, "/?" + urlsplit(served).query)
    assert status == 200 and headers["set-cookie"].endswith("; HttpOnly; Path=/; SameSite=strict")
    return headers["set-cookie"].split(";")[0]


def test_without_the_token_nothing_is_shown(served: str) -> None:
    parts = {"key": "1", "first": "1", "second": "1", "what": "about", "name": "run.mcap"}
    routes = [route.path.format(**parts) for route in Routes(None, None, None).routes()]  # type: ignore[arg-type, attr-defined]
    assert len(routes) == 10
    for path in (*routes, "/data/1/frames?first=0&count=9", "/?token=guess", "/none"):
        status, _, body = get(served, path)
        assert status == 401 and b"as `llm-flock view` printed it" in body and b"circle" not in body


def test_pages_with_the_token_carry_a_policy_but_not_the_key(served: str, cookie: str) -> None:
    for path in ("/", "/run/KEY", "/cockpit", "/runs", "/data/KEY/about", "/data/KEY/news", "/data/KEY/frames?count=9"):
        path = path.replace("KEY", keys_of(served)[0])
        status, headers, body = get(served, path, Cookie=cookie)
        assert status == 200, path
        assert "default-src 'self'" in headers["content-security-policy"]
        assert SECRET.encode() not in body


def test_no_file_is_read_but_the_records_that_were_given(served: str, cookie: str) -> None:
    for path in (
        "/data/../secret.txt",
        "/data/..%2f..%2fsecret.txt/about",
        "/data/1/about",
        "/run/other",
        "/run/..%2fother",
        "/secret.txt",
        "/static/../../secret.txt",
        "/export/KEY/..%2f..%2fsecret.txt",
        "/export/KEY/secret.txt",
        "/export/..%2fsecret.txt/run.mcap",
    ):
        status, _, body = get(served, path.replace("KEY", keys_of(served)[0]), Cookie=cookie)
        assert status in (400, 403, 404), path
        assert SECRET.encode() not in body and b"from __future__" not in body


@pytest.mark.parametrize("origin", ["", "http://evil.example", None, "null"])
def test_websocket_is_refused_to_any_client(served: str, cookie: str, origin: str | None) -> None:
    parts = urlsplit(served)
    host = f"{parts.hostname}:{parts.port}"
    lines = [
        "GET /data/1/news HTTP/1.1",
        f"Host: {host}",
        "Upgrade: websocket",
        "Connection: Upgrade",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version: 13",
        f"Cookie: {cookie}",
    ]
    if origin is not None:
        lines.append(f"Origin: {origin or f'http://{host}'}")
    assert parts.hostname is not None and parts.port is not None
    with socket.create_connection((parts.hostname, parts.port), timeout=20) as connection:
        connection.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
        assert connection.recv(100).split()[1] != b"101"


def ordered(url: str, order: str, **headers: str) -> tuple[int, bytes]:
    parts = urlsplit(url)
    assert parts.hostname is not None
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=20)
    try:
        connection.request("POST", "/order", order, headers)
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


def test_orders_need_the_token_the_own_origin_and_json(served: str, cookie: str) -> None:
    own = "http://" + urlsplit(served).netloc
    kind = {"Content-Type": "application/json"}
    (key,) = keys_of(served)
    delete = f'{{"order": "delete", "run": "{key}"}}'
    assert ordered(served, delete, Origin=own, **kind)[0] == 401
    for origin in ({}, {"Origin": "http://evil.example"}, {"Origin": "null"}):
        assert ordered(served, delete, Cookie=cookie, **origin, **kind)[0] == 403
    # A form of another site can send text, but no JSON.
    assert ordered(served, delete, Cookie=cookie, Origin=own, **{"Content-Type": "text/plain"})[0] == 415
    for order in (
        "[",
        "[]",
        '"x"',
        "{}",
        '{"order": "delete", "run": "../secret.txt"}',
        '{"order": "kill", "runs": [3]}',
    ):
        status, body = ordered(served, order, Cookie=cookie, Origin=own, **kind)
        assert status == 400 if order == "[" else b"error" in body, order
    assert ordered(served, "x" * 200_000, Cookie=cookie, Origin=own, **kind)[0] == 413
    assert get(served, f"/data/{key}/about", Cookie=cookie)[0] == 200, "the record is still there"


def test_a_foreign_page_may_not_read(served: str, cookie: str) -> None:
    assert get(served, "/data/runs", Cookie=cookie, Origin="http://evil.example")[0] == 403


def test_a_browser_is_led_to_the_token_without_telling_others(tmp_path: Path, browser: Browser) -> None:
    told = tmp_path / "told"
    script = tmp_path / "browser.sh"
    script.write_text(f'#!/bin/sh\necho "$1" > {told}.new && mv {told}.new {told}\n')
    script.chmod(0o700)
    token = "correct horse & battery"
    environment = {**os.environ, "BROWSER": str(script), "LLM_FLOCK_TOKEN": token}
    command = [sys.executable, "-m", "llm_flock", "view", "--port", "0"]
    with subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            url = process.stdout.readline().strip()
            assert quote(token, safe="") in url
            until(told.exists, "a browser is started")
            opened = told.read_text().strip()
            assert "battery" not in opened and Path(unquote(urlsplit(opened).path)).parent.stat().st_mode & 0o077 == 0
            page = browser.new_page()
            page.goto(opened)
            page.wait_for_url(url.partition("?")[0])
            page.locator(".flock-shape").first.wait_for()
            assert page.evaluate("[document.cookie, history.length]") == ["", 2], "the token is in no history"
            process.send_signal(signal.SIGINT)
            process.wait(60)
            assert not Path(unquote(urlsplit(opened).path)).parent.exists()
        finally:
            process.kill()
