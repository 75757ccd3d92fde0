"""Somebody is at the door from the first moment, and hands it over."""

from __future__ import annotations

import socket
import threading

from llm_flock.viewer.greeter import PAGE
from llm_flock.viewer.server import listen


def ask(port: int, text: str) -> bytes:
    with socket.create_connection(("127.0.0.1", port), timeout=10) as guest:
        guest.sendall(text.encode())
        answer = b""
        while part := guest.recv(65536):
            answer += part
        return answer


def test_a_browser_sees_a_page_and_then_waits_for_the_viewer() -> None:
    address = listen("127.0.0.1", 0, None)
    assert ask(address.port, "GET /data/1/about HTTP/1.1\r\nAccept: */*\r\n\r\n").startswith(b"HTTP/1.1 503 ")
    assert ask(address.port, "nonsense").startswith(b"HTTP/1.1 503 ")
    answer = ask(address.port, "GET / HTTP/1.1\r\nAccept: text/html,*/*\r\n\r\n")
    assert answer.startswith(b"HTTP/1.1 200 OK\r\n") and answer.endswith(PAGE)
    assert b"default-src 'none'" in answer
    second: list[bytes] = []
    waiting = threading.Thread(target=lambda: second.append(ask(address.port, "GET / HTTP/1.1\r\n\r\n")))
    waiting.start()
    waiting.join(0.3)
    assert waiting.is_alive()
    address.greeter.stop()
    guest, _ = address.sock.accept()
    with guest:
        assert guest.recv(1000).startswith(b"GET /")
        guest.sendall(b"the viewer")
    waiting.join(10)
    assert second == [b"the viewer"]
    address.sock.close()


def test_it_leaves_when_nobody_came() -> None:
    address = listen("127.0.0.1", 0, None)
    address.greeter.stop()
    address.sock.close()
