"""A network of peers: eclipse-zenoh sessions without router, multicast or server.

Every process is a peer that listens on its own endpoint and connects to a few others (a seed is enough): zenoh's gossip
tells it the rest, and all link up with all. So a seed that dies takes nobody with it. A lease of two seconds ends a
link whose other side says nothing any more; a process that ends is noticed within milliseconds.

zenoh calls back from its own threads, straight from where the bytes came in: a thread in between for each subscription
would be woken for each message. `Link` hands everything over to the event loop, where payloads are opened.
"""

from __future__ import annotations

import asyncio
import json
import os
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

from llm_flock.errors import InputError, MessageError
from llm_flock.transport.seal import Seal

if TYPE_CHECKING:
    import zenoh

ROOT = "llm-flock"
MAX_SEALED_BYTES = 1 << 20
"""Nothing larger is opened [bytes]; what robots say to each other has a limit of its own, far below."""

THREADS = "(rx: (worker_threads: 1), net: (handover: tx), acc: (handover: tx), app: (handover: tx))"
"""zenoh's threads: one that receives and one for all else. With more, each message wakes two or three of them."""

KEEP_ALIVES = 4
"""So many signs of life per lease."""

Handler: TypeAlias = Callable[[int, bytes], None]
"""Takes a sender and what it sent."""


def settings(
    *, listen: Sequence[str], connect: Sequence[str], lease_s: float, security: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """A peer's configuration, by path.

    Args:
        listen: own endpoints, such as `tcp/127.0.0.1:7447`; port 0 takes a free one.
        connect: endpoints of peers that may be there already.
        lease_s: silence after which a link is given up [s].
        security: more of the configuration: certificates, what is asked of the other side.
    """
    return {
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "transport/link/tx/lease": round(1000 * lease_s),
        "transport/link/tx/keep_alive": KEEP_ALIVES,
        **(security or {}),
    }


def open_session(values: Mapping[str, Any]) -> zenoh.Session:
    """Open a session.

    Raises:
        InputError: zenoh is not installed, or does not take the configuration (an endpoint that is in use, say).
    """
    os.environ.setdefault("ZENOH_RUNTIME", THREADS)
    try:
        import zenoh
    except ImportError:
        raise InputError("network", "not installed", "with the extra: pip install 'llm-flock[network]'") from None
    config: Any = zenoh.Config()  # its types are unknown in part
    try:
        for path, value in values.items():
            config.insert_json5(path, json.dumps(value))
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise InputError("listen", values.get("listen/endpoints"), f"endpoints that can be opened ({error})") from None


def _straight(take: Callable[[zenoh.Sample], None]) -> Any:
    """A handler that is called in the thread in which a sample came in, and has to be quick."""
    import zenoh

    return zenoh.handlers.Callback(take, indirect=False)


@dataclass(slots=True)
class LinkTraffic:
    """What one process has sent, each payload once, and what it refused to open."""

    sent: Counter[str] = field(default_factory=Counter[str])
    bytes: Counter[str] = field(default_factory=Counter[str])
    refused: Counter[str] = field(default_factory=Counter[str])


class Link:
    """One process's part in a swarm's network: topics out, topics in.

    A topic is `kind/id`. What is sent is dropped rather than waited with when a receiver does not keep up.

    Args:
        session: an open zenoh session; closed by `close`.
        swarm: name of the swarm; others on the same network are not heard.
        own: own id, as `seal` tells it: own messages are not heard.
        seal: closes and opens payloads.
        loop: where handlers run.
    """

    def __init__(
        self, session: zenoh.Session, *, swarm: str, own: int | None, seal: Seal, loop: asyncio.AbstractEventLoop
    ) -> None:
        self.traffic = LinkTraffic()
        self._session: Any = session
        self._root = f"{ROOT}/{swarm}"
        self._own = own
        self._seal = seal
        self._loop = loop
        self._publishers: dict[str, Any] = {}
        self._kept: list[Any] = []
        self._closed = False
        self._came: deque[tuple[Callable[..., None], tuple[Any, ...]]] = deque()
        self._called = False

    def publish(self, kind: str, number: int, payload: bytes) -> None:
        """Send to all who listen to `kind` of this number, or of all."""
        topic = f"{kind}/{number}"
        publisher = self._publishers.get(topic)
        if publisher is None:
            import zenoh

            publisher = self._publishers[topic] = self._session.declare_publisher(
                f"{self._root}/{topic}", congestion_control=zenoh.CongestionControl.DROP, express=True
            )
        sealed = self._seal.seal(payload, topic)
        self.traffic.sent[kind] += 1
        self.traffic.bytes[kind] += len(sealed)
        publisher.put(sealed)

    def listen(self, kind: str, number: int | None, handler: Handler) -> None:
        """Hand over, in the event loop, what comes in of a kind, for one number or for all.

        What was published under the number of another sender than the one that its seal names is refused, unless the
        topic belongs to the receiver (`number` is given).
        """

        def take(sample: zenoh.Sample) -> None:
            self._call(self._take, str(sample.key_expr), kind, number, sample.payload.to_bytes(), handler)

        key = f"{self._root}/{kind}/{'*' if number is None else number}"
        self._kept.append(self._session.declare_subscriber(key, _straight(take)))

    def _call(self, function: Callable[..., None], *args: Any) -> None:
        """From a thread of zenoh's: have the loop call this; it is woken once for all that comes meanwhile."""
        self._came.append((function, args))
        if self._called or self._closed:
            return
        self._called = True
        try:
            self._loop.call_soon_threadsafe(self._take_all)
        except RuntimeError:  # the loop has ended between the two lines
            self._closed = True

    def _take_all(self) -> None:
        self._called = False  # first: what comes from now on may be left to the next call
        for _ in range(len(self._came)):
            function, args = self._came.popleft()
            self._loop.call_soon(function, *args)

    def _take(self, key: str, kind: str, number: int | None, sealed: bytes, handler: Handler) -> None:
        if self._closed or (number is None and key.rpartition("/")[2] == str(self._own)):
            return
        try:
            if len(sealed) > MAX_SEALED_BYTES:
                raise MessageError("oversized", f"{len(sealed)} bytes")
            sender, payload = self._seal.open(sealed, key.removeprefix(f"{self._root}/"))
            if number is None and key.rpartition("/")[2] != str(sender):
                raise MessageError("wrong_topic", f"{sender} in {kind}")
        except MessageError as error:
            self.traffic.refused[error.reason] += 1
            return
        if sender != self._own:
            handler(sender, payload)

    def be_alive(self, number: int) -> None:
        """Declare that this number is there, as long as the process runs."""
        self._kept.append(self._session.liveliness().declare_token(f"{self._root}/alive/{number}"))

    def watch_alive(self, handler: Callable[[int, bool], None]) -> None:
        """Hand over who comes and who goes; those that are there already come at once."""
        import zenoh

        def take(sample: zenoh.Sample) -> None:
            number = str(sample.key_expr).rpartition("/")[2]
            if number.lstrip("-").isdecimal():
                self._call(handler, int(number), sample.kind == zenoh.SampleKind.PUT)

        key = f"{self._root}/alive/*"
        self._kept.append(self._session.liveliness().declare_subscriber(key, _straight(take), history=True))

    def close(self) -> None:
        """Leave the network."""
        if not self._closed:
            self._closed = True
            self._session.close()
