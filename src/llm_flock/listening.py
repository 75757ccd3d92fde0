"""Opens the port of a server: by default for this machine only, with a token for any other address."""

from __future__ import annotations

import errno
import ipaddress
import os
import secrets
import socket
from dataclasses import dataclass
from urllib.parse import quote

from llm_flock.errors import FieldError, InputError
from llm_flock.printable import hidden

SHORTEST_TOKEN = 16
"""Fewest characters of a token."""


def is_loopback(host: str) -> bool:
    """Whether a host is a loopback address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


@dataclass(frozen=True, slots=True, kw_only=True)
class ListeningPort:
    """A socket that listens, the host as it was given, and the token that clients must show; None for none."""

    sock: socket.socket
    host: str
    token: str | None

    @property
    def number(self) -> int:
        """The port."""
        return self.sock.getsockname()[1]

    def url(self, scheme: str) -> str:
        """The address for a client on this machine, with the token."""
        query = "" if self.token is None else f"?token={quote(self.token, safe='')}"
        return f"{scheme}://{shown_host(self.host)}:{self.number}/{query}"


def open_port(host: str, port: int, token: str | None, field: str = "") -> ListeningPort:
    """Listen at an address. `field` begins the names in errors.

    An address other than a loopback address gets a token, a random one where none is given.

    Raises:
        InputError: the address cannot be listened at, or the token is too short; no error shows a token.
    """
    if token is not None and (len(token) < SHORTEST_TOKEN or hidden(token) is not None):
        raise InputError(f"{field}token", None, f"{SHORTEST_TOKEN} characters or more, all of them visible")
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
            flag = f"--{field}port".replace("_", "-")
            says = f"port {port} is taken; try {flag} 0, which takes a free one"
            raise FieldError(f"{field}port", port, says=says) from None
        says = f"this machine cannot listen there: {getattr(error, 'strerror', None) or error}"
        raise InputError(f"{field}host", host, says=says) from None
    return ListeningPort(sock=sock, host=host, token=token)


def shown_host(host: str) -> str:
    """A host to which a client on this machine can be pointed."""
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
    return f"[{host}]" if ":" in host else host
