"""The address at which a viewer listens: one port, by default for this machine only."""

from __future__ import annotations

import ipaddress
import secrets
import socket
from collections.abc import Sequence
from dataclasses import dataclass

from llm_flock.errors import InputError
from llm_flock.viewer.startup import StartupServer


@dataclass(frozen=True, slots=True, kw_only=True)
class Address:
    """The address at which a viewer listens; `startup` answers there until the viewer does.

    A browser must show the `token`; a loopback address needs none.
    """

    sock: socket.socket
    host: str
    port: int
    token: str | None
    startup: StartupServer

    @property
    def shown_host(self) -> str:
        """A host that a browser can be pointed to."""
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.host, self.host)
        return f"[{host}]" if ":" in host else host

    @property
    def url(self) -> str:
        """The address to open, with the token."""
        token = "" if self.token is None else f"?token={self.token}"
        return f"http://{self.shown_host}:{self.port}/{token}"

    @property
    def hosts(self) -> Sequence[str]:
        """Values of the Host header that are accepted; none (any) where the machine's names are not known here."""
        if self.host in ("0.0.0.0", "::"):
            return ()
        names = {self.shown_host} | ({"127.0.0.1", "localhost", "[::1]"} if is_loopback(self.host) else set[str]())
        return [f"{name}:{self.port}" for name in sorted(names)]


def is_loopback(host: str) -> bool:
    """Whether a host is a loopback address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def listen(host: str, port: int, token: str | None) -> Address:
    """Open the port. Call it before anything heavy is loaded: a browser that comes early waits instead of failing.

    An address other than a loopback address gets a token, a random one where none is given.

    Raises:
        InputError: the address cannot be listened at, or the token is too short.
    """
    if token is not None and len(token) < 16:
        raise InputError("token", token, "16 characters or more")
    if token is None and not is_loopback(host):
        token = secrets.token_urlsafe(24)
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        sock = socket.socket(family, socket.SOCK_STREAM)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((host, port))
        sock.listen(64)
    except (OSError, OverflowError) as error:
        raise InputError("host and port", f"{host}:{port}", f"an address that can be listened at ({error})") from None
    return Address(sock=sock, host=host, port=sock.getsockname()[1], token=token, startup=StartupServer(sock))
