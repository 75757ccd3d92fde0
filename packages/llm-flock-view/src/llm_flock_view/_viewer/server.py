"""The address at which a viewer listens: one port, by default for this machine only, and a token."""

from __future__ import annotations

import errno
import os
import secrets
import socket
from dataclasses import dataclass
from urllib.parse import quote

from llm_flock.errors import FieldError, InputError
from llm_flock.printable import hidden

MIN_TOKEN_LENGTH = 16  # fewest characters of a token


@dataclass(frozen=True, slots=True, kw_only=True)
class Address:
    """The address at which a viewer listens, with the host as it was given; a browser must show the token."""

    sock: socket.socket
    host: str
    token: str

    @property
    def port(self) -> int:
        return self.sock.getsockname()[1]

    @property
    def url(self) -> str:
        """The address to open, with the token, and a host that a browser can be pointed to."""
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.host, self.host)  # noqa: S104
        shown = f"[{host}]" if ":" in host else host
        return f"http://{shown}:{self.port}/?token={quote(self.token, safe='')}"


def listen(host: str, port: int, token: str | None) -> Address:
    """Open the port early, so that a browser waits instead of failing. Without a token, a random one is taken."""
    token = secrets.token_urlsafe(24) if token is None else token
    if len(token) < MIN_TOKEN_LENGTH or hidden(token) is not None:
        raise InputError("token", None, f"{MIN_TOKEN_LENGTH} characters or more, all of them visible")
    sock = None
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        sock = socket.socket(family, socket.SOCK_STREAM)
        if os.name == "posix":  # on Windows, it would share a port that is in use
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((host, port))
        sock.listen(64)
    except (OSError, OverflowError, UnicodeError) as error:
        if sock is not None:
            sock.close()
        if isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
            says = f"port {port} is taken; try --port 0, which takes a free one"
            raise FieldError("port", port, says=says) from None
        says = f"this machine cannot listen there: {getattr(error, 'strerror', None) or error}"
        raise InputError("host", host, says=says) from None
    return Address(sock=sock, host=host, token=token)
