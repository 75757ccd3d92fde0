"""Answers browsers while the viewer's libraries load: a page appears at once, not after seconds."""

from __future__ import annotations

import contextlib
import logging
import select
import socket
import threading
from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple
from urllib.parse import parse_qsl

logger = logging.getLogger(__name__)

POLL_S = 0.05
READ_S = 0.5
LEAVE_S = 1.0
"""Time that answers in progress get to finish when the viewer takes over [s]."""

LONGEST = 65536
LAST = "/mind"
"""End of the path that a page asks for last, before it is whole."""

OPEN = "/data/open"
"""Answered when the viewer takes over; a page from before asks for it, and then reloads itself."""

PAGE = b"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<meta name="color-scheme" content="light dark"><title>LLM-Flock</title><link rel="icon" href="data:,">
<style>
body { margin: 0; padding: 12px; background: #f6f7f9; color: #1d232a; font: 14px system-ui, "DejaVu Sans", sans-serif; }
@media (prefers-color-scheme: dark) { body { background: #12161b; color: #e8eaed; } }
b { font-size: 16px; }
</style></head>
<body><b>LLM-Flock</b> the viewer is starting &hellip;
<script>fetch("/data/open").then((answer) => answer.text()).catch(() => 0).then(() => location.reload());</script>
</body></html>
"""

_HEADERS = (
    b"Cache-Control: no-store\r\nConnection: close\r\nX-Content-Type-Options: nosniff\r\n"
    b"Content-Security-Policy: default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline' data:; "
    b"img-src data:; connect-src 'self'; frame-ancestors 'none'; base-uri 'none'\r\n"
)

AnswerData = Callable[[str, Mapping[str, str]], bytes | None]
"""Answers a path and its query with JSON, or with None."""


class _Request(NamedTuple):
    """The parts of a GET request that matter here; `page` says whether the browser asks for HTML."""

    path: str
    query: Mapping[str, str]
    page: bool
    host: str
    origin: str


def _parse(text: str) -> _Request | None:
    """None for anything but a GET request."""
    first, *rest = text.split("\r\n")
    words = first.split(" ")
    if len(words) != 3 or words[0] != "GET" or not words[1].startswith("/"):
        return None
    heads = {name.strip().lower(): value.strip() for name, _, value in (line.partition(":") for line in rest)}
    path, _, query = words[1].partition("?")
    page = "text/html" in heads.get("accept", "")
    return _Request(path, dict(parse_qsl(query)), page, heads.get("host", "").lower(), heads.get("origin", "").lower())


class StartupServer:
    """Answers on the viewer's socket until the viewer takes over; starts at once, in a thread.

    Any browser gets a page that says that the viewer is starting. After `show`, the viewer's own pages get the run.
    """

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._page: bytes | None = None
        self._hosts: Collection[str] = ()
        self._answer_data: AnswerData | None = None
        self._data_known = threading.Event()
        self._asked = threading.Event()
        self._drawn = threading.Event()
        self._stop = threading.Event()
        self._open = threading.Event()
        self._connections: list[threading.Thread] = []
        self._thread = threading.Thread(target=self._accept, daemon=True)
        self._thread.start()

    def show(self, page: bytes, hosts: Collection[str]) -> None:
        """Answer with a page that draws a run; its requests for data wait until `answer_data`.

        Pages of other sites get nothing: their Host header is none of `hosts`.
        """
        self._page, self._hosts = page, frozenset(hosts)

    def answer_data(self, answer: AnswerData) -> None:
        """Answer requests for data from now on."""
        self._answer_data = answer
        self._data_known.set()

    def wait_for_page(self, most_s: float) -> None:
        """Wait until a page that was answered has all that it shows first; not at all if no page was asked for."""
        if self._asked.is_set():
            self._drawn.wait(most_s)

    def stop(self) -> None:
        """Hand the socket over. Accepted connections are still answered; later ones wait for the viewer."""
        self._stop.set()
        self._thread.join()
        # After the join: a page that hears that the viewer is open reloads at once, and must not come here again.
        self._open.set()
        self._data_known.set()
        for connection in self._connections:
            connection.join(LEAVE_S)

    def _accept(self) -> None:
        while not self._stop.is_set():
            ready, _, _ = select.select([self._sock], [], [], POLL_S)
            if not ready:
                continue
            with contextlib.suppress(OSError):
                connection, _ = self._sock.accept()
                # A browser opens spare connections that ask for nothing: none may keep the others waiting.
                self._connections = [one for one in self._connections if one.is_alive()]
                self._connections.append(threading.Thread(target=self._handle, args=(connection,), daemon=True))
                self._connections[-1].start()

    def _handle(self, connection: socket.socket) -> None:
        with contextlib.suppress(OSError), connection:
            connection.settimeout(READ_S)
            request = _parse(connection.recv(LONGEST).decode("latin-1"))
            status, kind, body = self._respond(request)
            head = f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\n"
            connection.sendall(head.encode() + _HEADERS + b"\r\n" + body)
            if request is not None and request.path.endswith(LAST):
                self._drawn.set()

    def _respond(self, request: _Request | None) -> tuple[str, str, bytes]:
        if request is not None and request.path == OPEN:
            self._open.wait()
            return "200 OK", "text/plain", b""
        if request is not None and request.page:
            if request.path != "/" or self._page is None or not self._is_own(request):
                return "200 OK", "text/html; charset=utf-8", PAGE
            self._asked.set()
            return "200 OK", "text/html; charset=utf-8", self._page
        if request is not None and self._page is not None and self._is_own(request):
            self._data_known.wait()
            try:
                body = None if self._answer_data is None else self._answer_data(request.path, request.query)
            except Exception:  # a record is a file from anywhere; the viewer reports what is wrong with it
                logger.warning("the preview of the record failed", exc_info=True)
                body = None
            if body is not None:
                return "200 OK", "application/json", body
        return "503 Service Unavailable\r\nRetry-After: 1", "text/plain", b"the viewer is starting"

    def _is_own(self, request: _Request) -> bool:
        """Whether the request comes from a page of the viewer, not of another site by whatever name."""
        return request.host in self._hosts and request.origin in ("", f"http://{request.host}")
