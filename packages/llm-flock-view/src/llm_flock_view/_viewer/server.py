"""The address at which a viewer listens: one port, by default for this machine only, else with a token."""

from __future__ import annotations

import errno
import ipaddress
import os
import secrets
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import quote

from llm_flock.errors import FieldError, InputError
from llm_flock.printable import hidden

MIN_TOKEN_LENGTH = 16
"""Fewest characters of a token."""


def is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


@dataclass(frozen=True, slots=True, kw_only=True)
class Address:
    """The address at which a viewer listens, with the host as it was given; a browser must show the token, if any."""

    sock: socket.socket
    host: str
    token: str | None

    @property
    def port(self) -> int:
        return self.sock.getsockname()[1]

    @property
    def shown_host(self) -> str:
        """A host that a browser can be pointed to."""
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.host, self.host)  # noqa: S104 - compared
        return f"[{host}]" if ":" in host else host

    @property
    def url(self) -> str:
        """The address to open, with the token."""
        query = "" if self.token is None else f"?token={quote(self.token, safe='')}"
        return f"http://{self.shown_host}:{self.port}/{query}"

    @property
    def hosts(self) -> Sequence[str]:
        """Values of the Host header that are accepted; none (any) where the machine's names are not known here."""
        if self.host in ("0.0.0.0", "::"):  # noqa: S104 - compared
            return ()
        names = {self.shown_host} | ({"127.0.0.1", "localhost", "[::1]"} if is_loopback(self.host) else set[str]())
        return [f"{name}:{self.port}" for name in sorted(names)]


def listen(host: str, port: int, token: str | None) -> Address:
    """Open the port early, so that a browser waits instead of failing. Other than a loopback address needs a token."""
    if token is not None and (len(token) < MIN_TOKEN_LENGTH or hidden(token) is not None):
        raise InputError("token", None, f"{MIN_TOKEN_LENGTH} characters or more, all of them visible")
    if token is None and not is_loopback(host):
        token = secrets.token_urlsafe(24)
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
