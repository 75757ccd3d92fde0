"""Connections that send no request, or are too many, take no file handles from the viewer."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator

import pytest
import uvicorn
from starlette.applications import Starlette
from starlette.responses import PlainTextResponse
from starlette.routing import Route

from llm_flock_view._viewer import connections

WHOLE = b"GET / HTTP/1.1\r\nHost: here\r\n\r\n"


@pytest.fixture
def port(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    monkeypatch.setattr(connections, "HEAD_S", 0.3)
    monkeypatch.setattr(connections, "MAX_CONNECTIONS", 3)
    app = Starlette(routes=[Route("/", lambda _: PlainTextResponse("well"))])
    server = uvicorn.Server(uvicorn.Config(app, http=connections.PatientConnection, ws="none", log_level="error"))
    listening = socket.create_server(("127.0.0.1", 0))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    yield listening.getsockname()[1]
    server.should_exit = True
    thread.join(10)


def connected(port: int, *sent: bytes) -> socket.socket:
    connection = socket.create_connection(("127.0.0.1", port), timeout=5)
    for part in sent:
        connection.sendall(part)
    return connection


@pytest.mark.parametrize("sent", [[b""], [b"GET / HTTP/1.1\r\nX: "]], ids=["nothing", "half a request"])
def test_a_connection_without_a_request_ends(port: int, sent: list[bytes]) -> None:
    with connected(port, *sent) as connection:
        assert connection.recv(100) == b""


def test_half_a_request_after_a_whole_one_ends(port: int) -> None:
    with connected(port, WHOLE) as connection:
        assert connection.recv(1000).endswith(b"well")
        connection.sendall(WHOLE[:20])
        assert connection.recv(100) == b""


def test_one_connection_too_many_ends_at_once(port: int) -> None:
    three = [connected(port, WHOLE) for _ in range(3)]
    assert all(one.recv(1000).endswith(b"well") for one in three)
    with connected(port) as fourth:
        assert fourth.recv(100) == b""
    for one in three:
        one.close()
