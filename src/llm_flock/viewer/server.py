"""The address at which a viewer listens: one port, by default for this machine only."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from dataclasses import dataclass

from llm_flock.listening import ListeningPort, is_loopback, open_port, shown_host
from llm_flock.viewer.startup import StartupServer


@dataclass(frozen=True, slots=True, kw_only=True)
class Address:
    """The address at which a viewer listens; `startup` answers there until the viewer does."""

    listening: ListeningPort
    startup: StartupServer

    @property
    def sock(self) -> socket.socket:
        """The socket."""
        return self.listening.sock

    @property
    def port(self) -> int:
        """The port."""
        return self.listening.number

    @property
    def token(self) -> str | None:
        """What a browser must show; a loopback address needs none."""
        return self.listening.token

    @property
    def host(self) -> str:
        """The host as it was given."""
        return self.listening.host

    @property
    def shown_host(self) -> str:
        """A host that a browser can be pointed to."""
        return shown_host(self.host)

    @property
    def url(self) -> str:
        """The address to open, with the token."""
        return self.listening.url("http")

    @property
    def hosts(self) -> Sequence[str]:
        """Values of the Host header that are accepted; none (any) where the machine's names are not known here."""
        if self.host in ("0.0.0.0", "::"):
            return ()
        names = {self.shown_host} | ({"127.0.0.1", "localhost", "[::1]"} if is_loopback(self.host) else set[str]())
        return [f"{name}:{self.port}" for name in sorted(names)]


def listen(host: str, port: int, token: str | None) -> Address:
    """Open the port. Call it before anything heavy is loaded: a browser that comes early waits instead of failing.

    An address other than a loopback address gets a token, a random one where none is given.

    Raises:
        InputError: the address cannot be listened at, or the token is too short.
    """
    listening = open_port(host, port, token)
    return Address(listening=listening, startup=StartupServer(listening.sock))
