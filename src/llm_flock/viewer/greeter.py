"""Attends to the door while the viewer's libraries load: a page within moments of the command, not after seconds."""

from __future__ import annotations

import contextlib
import logging
import select
import socket
import threading
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from urllib.parse import parse_qsl

logger = logging.getLogger(__name__)

LOOK_S = 0.05
READ_S = 0.5
LEAVE_S = 1.0
"""Time for answers that were begun when the viewer takes over [s]."""

LONGEST = 65536
OPEN = "/data/open"
"""Answered when the viewer takes over; a page that was painted before asks for it, and then for itself once more."""

PAGE = b"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<meta name="color-scheme" content="light dark"><title>LLM-Flock</title><link rel="icon" href="data:,">
<style>
body { margin: 0; padding: 12px; background: #f6f7f9; color: #1d232a; font: 14px system-ui, "DejaVu Sans", sans-serif; }
@media (prefers-color-scheme: dark) { body { background: #12161b; color: #e8eaed; } }
b { font-size: 16px; }
</style></head>
<body><b>LLM-Flock</b> the viewer is starting &hellip;
<script>fetch("/data/open").catch(() => 0).then(() => location.reload());</script></body></html>
"""

_HEADERS = (
    b"Cache-Control: no-store\r\nConnection: close\r\nX-Content-Type-Options: nosniff\r\n"
    b"Content-Security-Policy: default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline' data:; "
    b"img-src data:; connect-src 'self'; frame-ancestors 'none'; base-uri 'none'\r\n"
)

Told = Callable[[str, Mapping[str, str]], bytes | None]
"""Answers a path and its query with JSON, or with nothing."""


@dataclass(frozen=True, slots=True)
class _Asked:
    """A request: what of it matters here."""

    path: str
    query: Mapping[str, str]
    page: bool
    host: str
    origin: str

    @classmethod
    def of(cls, text: str) -> _Asked | None:
        """None for anything but a GET."""
        first, *rest = text.split("\r\n")
        words = first.split(" ")
        if len(words) != 3 or words[0] != "GET" or not words[1].startswith("/"):
            return None
        heads = {name.strip().lower(): value.strip() for name, _, value in (line.partition(":") for line in rest)}
        path, _, query = words[1].partition("?")
        page = "text/html" in heads.get("accept", "")
        return cls(path, dict(parse_qsl(query)), page, heads.get("host", "").lower(), heads.get("origin", "").lower())


class Greeter:
    """Answers browsers at a door that nobody else attends to yet.

    Whoever asks is told that the viewer starts, with a token or without. A run is shown only after `show`, and only to
    pages of this viewer.

    Args:
        sock: listens.
    """

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._page: bytes | None = None
        self._hosts: Collection[str] = ()
        self._told: Told | None = None
        self._can_tell = threading.Event()
        self._stop = threading.Event()
        self._open = threading.Event()
        self._guests: list[threading.Thread] = []
        self._thread = threading.Thread(target=self._greet, daemon=True)
        self._thread.start()

    def show(self, page: bytes, hosts: Collection[str]) -> None:
        """Answer with a page that draws a run; what it asks for waits until `tell`.

        Args:
            page: the whole page.
            hosts: names and ports under which the viewer is asked for: nobody else's pages are shown anything.
        """
        self._page, self._hosts = page, frozenset(hosts)

    def tell(self, told: Told) -> None:
        """Answer what the page asks for from now on."""
        self._told = told
        self._can_tell.set()

    def stop(self) -> None:
        """Leave the door to the viewer. Who has been let in is still answered; who comes now waits for the viewer."""
        self._stop.set()
        self._thread.join()
        # Only now: a page that is told that the viewer is there comes back at once, and must not find the greeter.
        self._open.set()
        self._can_tell.set()
        for guest in self._guests:
            guest.join(LEAVE_S)

    def _greet(self) -> None:
        while not self._stop.is_set():
            ready, _, _ = select.select([self._sock], [], [], LOOK_S)
            if not ready:
                continue
            with contextlib.suppress(OSError):
                guest, _ = self._sock.accept()
                # A browser opens connections in advance that ask for nothing: none may keep the others waiting.
                self._guests = [one for one in self._guests if one.is_alive()]
                self._guests.append(threading.Thread(target=self._attend, args=(guest,), daemon=True))
                self._guests[-1].start()

    def _attend(self, guest: socket.socket) -> None:
        with contextlib.suppress(OSError), guest:
            guest.settimeout(READ_S)
            asked = _Asked.of(guest.recv(LONGEST).decode("latin-1"))
            status, kind, body = self._answer(asked)
            head = f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\n"
            guest.sendall(head.encode() + _HEADERS + b"\r\n" + body)

    def _answer(self, asked: _Asked | None) -> tuple[str, str, bytes]:
        if asked is not None and asked.path == OPEN:
            self._open.wait()
            return "200 OK", "text/plain", b""
        if asked is not None and asked.page:
            page = self._page if asked.path == "/" and self._page is not None and self._own(asked) else PAGE
            return "200 OK", "text/html; charset=utf-8", page
        if asked is not None and self._page is not None and self._own(asked):
            self._can_tell.wait()
            try:
                body = None if self._told is None else self._told(asked.path, asked.query)
            except Exception:  # a record is a file from anywhere; the viewer says what is wrong with it
                logger.warning("the first look at the record failed", exc_info=True)
                body = None
            if body is not None:
                return "200 OK", "application/json", body
        return "503 Service Unavailable\r\nRetry-After: 1", "text/plain", b"the viewer is starting"

    def _own(self, asked: _Asked) -> bool:
        """Whether a page of the viewer asks, and no page of another site by whatever name."""
        return asked.host in self._hosts and asked.origin in ("", f"http://{asked.host}")
