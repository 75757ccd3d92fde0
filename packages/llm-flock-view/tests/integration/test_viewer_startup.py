"""The startup server answers from the first moment, shows the run, and hands its socket over."""

from __future__ import annotations

import json
import socket
import threading
from functools import partial
from pathlib import Path

import pytest
from sample_records import make_record

from llm_flock.errors import InputError
from llm_flock_view._viewer.canvases import player_options
from llm_flock_view._viewer.data import answer
from llm_flock_view._viewer.library import Library, load
from llm_flock_view._viewer.page import html
from llm_flock_view._viewer.server import Address, listen
from llm_flock_view._viewer.startup import PAGE

ACCEPT = "Accept: text/html,*/*"


def player(title: str) -> bytes:
    return html(title, player_options([("1", title)])).encode()


def ask(address: Address, path: str, *heads: str, host: str | None = None) -> bytes:
    own = f"127.0.0.1:{address.port}" if host is None else host
    return say(address, "\r\n".join((f"GET {path} HTTP/1.1", f"Host: {own}", *heads, "", "")))


def say(address: Address, text: str) -> bytes:
    with socket.create_connection(("127.0.0.1", address.port), timeout=10) as guest:
        guest.sendall(text.encode())
        received = b""
        while part := guest.recv(65536):
            received += part
        return received


def test_a_browser_sees_a_page_and_then_waits_for_the_viewer() -> None:
    address = listen("127.0.0.1", 0, None)
    assert ask(address, "/data/1/about").startswith(b"HTTP/1.1 503 ")
    assert say(address, "nonsense").startswith(b"HTTP/1.1 503 ")
    assert say(address, "POST / HTTP/1.1\r\nAccept: text/html\r\n\r\n").startswith(b"HTTP/1.1 503 ")
    page = ask(address, "/", ACCEPT)
    assert page.startswith(b"HTTP/1.1 200 OK\r\n") and page.endswith(PAGE)
    assert b"default-src 'none'" in page
    opened: list[bytes] = []
    waiting = threading.Thread(target=lambda: opened.append(ask(address, "/data/open")))
    waiting.start()
    waiting.join(0.3)
    assert waiting.is_alive(), "a page reloads only when the viewer can answer"
    address.startup.stop()
    waiting.join(10)
    assert opened[0].startswith(b"HTTP/1.1 200 OK\r\n")
    late: list[bytes] = []
    waiting = threading.Thread(target=lambda: late.append(ask(address, "/", ACCEPT)))
    waiting.start()
    guest, _ = address.sock.accept()
    with guest:
        assert guest.recv(1000).startswith(b"GET /")
        guest.sendall(b"the viewer")
    waiting.join(10)
    assert late == [b"the viewer"]
    address.sock.close()


def test_it_leaves_when_nobody_came_and_when_somebody_says_nothing() -> None:
    address = listen("127.0.0.1", 0, None)
    with socket.create_connection(("127.0.0.1", address.port)):
        address.startup.stop()
    address.sock.close()


def body(response: bytes) -> object:
    head, _, text = response.partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 200 OK\r\n"), response
    return json.loads(text)


def test_a_run_is_drawn_before_there_is_a_viewer(tmp_path: Path) -> None:
    record = make_record(tmp_path / "run.mcap", n=4, rounds=3)
    address = listen("127.0.0.1", 0, None)
    page = player("</script><b>")
    assert b"</script><b>" not in page
    address.startup.show(page, address.hosts)
    try:
        assert ask(address, "/", ACCEPT).endswith(page)
        assert ask(address, "/cockpit", ACCEPT).endswith(PAGE)
        early: list[bytes] = []
        waiting = threading.Thread(target=lambda: early.append(ask(address, "/data/1/about")))
        waiting.start()
        waiting.join(0.3)
        assert waiting.is_alive(), "data that is not known yet is waited for"
        library = Library()
        load(library.add("one", record, live=False))
        address.startup.answer_data(partial(answer, library))
        waiting.join(10)
        about = body(early[0])
        assert isinstance(about, dict) and about["robots"] == 4 and about["live"] is False
        news = body(ask(address, "/data/1/news?rounds=0&plans=0&missions=0"))
        assert isinstance(news, dict) and news["last"] == 3 and len(news["figures"]["procrustes_mean"]) == 4
        frames = body(ask(address, "/data/1/frames?first=1&count=2"))
        assert isinstance(frames, list) and [frame["r"] for frame in frames] == [1, 2]
        mind = body(ask(address, "/data/1/mind?robot=2&round=1"))
        assert isinstance(mind, dict) and mind["calls"][0]["verdict"] == "used: next waypoint (1, 2)"
        assert body(ask(address, "/data/1/mind?robot=9&round=1")) is None
        events = body(ask(address, "/data/1/events?round=1"))
        assert isinstance(events, dict) and events["total"] == 4
        assert isinstance(body(ask(address, "/data/1/frames?first=x&count=-3")), list)
        for nothing in ("/data/2/about", "/data/1/secret", "/data/../run.mcap", "/run.mcap"):
            assert ask(address, nothing).startswith(b"HTTP/1.1 503 "), nothing
    finally:
        address.startup.stop()
        address.sock.close()


def test_a_page_that_was_asked_for_gets_its_run_before_anything_else_is_loaded(tmp_path: Path) -> None:
    library = Library()
    load(library.add("one", make_record(tmp_path / "run.mcap", n=4, rounds=3), live=False))
    address = listen("127.0.0.1", 0, None)
    address.startup.show(player("one"), address.hosts)
    address.startup.answer_data(partial(answer, library))
    try:
        waiting = threading.Thread(target=lambda: address.startup.wait_for_page(30.0))
        waiting.start()
        waiting.join(10)
        assert not waiting.is_alive(), "nobody has asked for a page"
        ask(address, "/", ACCEPT)
        waiting = threading.Thread(target=lambda: address.startup.wait_for_page(30.0))
        waiting.start()
        ask(address, "/data/1/news?rounds=0&plans=0&missions=0")
        waiting.join(0.2)
        assert waiting.is_alive(), "the page lacks the mind of a robot"
        ask(address, "/data/1/mind?robot=2&round=1")
        waiting.join(10)
        assert not waiting.is_alive()
    finally:
        address.startup.stop()
        address.sock.close()


@pytest.mark.parametrize(
    ("host", "heads"),
    [
        ("elsewhere.example", ()),
        ("", ()),
        (None, ("Origin: http://elsewhere.example",)),
        (None, ("Origin: null",)),
    ],
)
def test_no_other_sites_page_is_shown_the_run(tmp_path: Path, host: str | None, heads: tuple[str, ...]) -> None:
    record = make_record(tmp_path / "run.mcap", n=4, rounds=3)
    address = listen("127.0.0.1", 0, None)
    library = Library()
    load(library.add("one", record, live=False))
    address.startup.show(player("one"), address.hosts)
    address.startup.answer_data(partial(answer, library))
    try:
        assert ask(address, "/", ACCEPT, *heads, host=host).endswith(PAGE)
        assert ask(address, "/data/1/about", *heads, host=host).startswith(b"HTTP/1.1 503 ")
    finally:
        address.startup.stop()
        address.sock.close()


def test_a_port_that_is_taken_is_named_with_a_way_out() -> None:
    first = listen("127.0.0.1", 0, None)
    try:
        with pytest.raises(InputError, match=rf"^port {first.port} is taken; try --port 0"):
            listen("127.0.0.1", first.port, None)
    finally:
        first.startup.stop()
        first.sock.close()
