"""Says that the viewer is coming while its libraries load: a page within moments of the command, not after seconds."""

from __future__ import annotations

import contextlib
import select
import socket
import threading

LOOK_S = 0.05
READ_S = 0.5
LONGEST = 65536

PAGE = b"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<meta name="color-scheme" content="light dark"><title>LLM-Flock</title>
<style>
body { margin: 0; padding: 12px; background: #f6f7f9; color: #1d232a; font: 14px system-ui, "DejaVu Sans", sans-serif; }
@media (prefers-color-scheme: dark) { body { background: #12161b; color: #e8eaed; } }
b { font-size: 16px; }
</style></head>
<body><b>LLM-Flock</b> the viewer is starting &hellip;
<script>
// The next request waits at the door until the viewer opens it; this page stays until then.
requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(() => location.reload(), 60)));
</script></body></html>
"""

_HEADERS = (
    b"Content-Type: text/html; charset=utf-8\r\nCache-Control: no-store\r\nConnection: close\r\n"
    b"Content-Security-Policy: default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; "
    b"frame-ancestors 'none'\r\n"
)


class Greeter:
    """Answers the first browser at a door that nobody else attends to yet.

    It shows no run and knows none: whoever asks is told the same, with a token or without.

    Args:
        sock: listens.
    """

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._greet, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Leave the door to the viewer."""
        self._stop.set()
        self._thread.join()

    def _greet(self) -> None:
        while not self._stop.is_set():
            ready, _, _ = select.select([self._sock], [], [], LOOK_S)
            if ready and self._answer():
                return  # whoever comes now waits, and is let in by the viewer

    def _answer(self) -> bool:
        """Whether it was a browser that asked for a page."""
        with contextlib.suppress(OSError):
            guest, _ = self._sock.accept()
            with guest:
                guest.settimeout(READ_S)
                asked = guest.recv(LONGEST).lower()
                page = asked.startswith(b"get ") and b"text/html" in asked
                body = PAGE if page else b"the viewer is starting"
                status = b"200 OK" if page else b"503 Service Unavailable\r\nRetry-After: 1"
                head = b"HTTP/1.1 " + status + b"\r\n" + _HEADERS + b"Content-Length: %d\r\n\r\n" % len(body)
                guest.sendall(head + body)
                return page
        return False
