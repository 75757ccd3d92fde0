"""Serves stand-ins, each behind a UDP socket of its own, in one thread."""

from __future__ import annotations

import selectors
import socket
import threading
import time
from typing import Generic, Protocol, Self, TypeVar


class Served(Protocol):
    """One stand-in: it takes what came to its socket, and a step at a time."""

    uri: str
    socket: socket.socket

    def receive(self) -> None: ...

    def tick(self) -> None: ...


V = TypeVar("V", bound=Served)


class ServedTeam(Generic[V]):
    """Several stand-ins and the thread that serves them, from `__enter__` to `__exit__`, every `step_s` [s]."""

    def __init__(self, step_s: float) -> None:
        self._members: list[V] = []
        self._step_s = step_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="stand-ins", daemon=True)

    @property
    def uris(self) -> list[str]:
        return [member.uri for member in self._members]

    def __getitem__(self, index: int) -> V:
        return self._members[index]

    def __len__(self) -> int:
        return len(self._members)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._close()

    def _close(self) -> None:
        for member in self._members:
            member.socket.close()

    def _between(self) -> None:
        """What happens between packets and steps."""

    def _serve(self) -> None:
        with selectors.DefaultSelector() as selector:
            for member in self._members:
                selector.register(member.socket, selectors.EVENT_READ, member)
            due = time.monotonic()
            while not self._stop.is_set():
                for key, _ in selector.select(max(0.0, due - time.monotonic())):
                    key.data.receive()
                self._between()
                if time.monotonic() >= due:
                    due = time.monotonic() + self._step_s
                    for member in self._members:
                        member.tick()
