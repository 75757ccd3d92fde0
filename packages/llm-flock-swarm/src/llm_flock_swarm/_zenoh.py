"""A network of peers: eclipse-zenoh sessions without router, multicast or server.

Every process listens on its own endpoint and connects to one or a few others: zenoh's gossip names the rest. A lease
ends a link whose other side has fallen silent. zenoh calls back in the thread that received the bytes: one more thread
per subscription would be woken for every message. `ZenohLink` hands everything over to the event loop.
"""

from __future__ import annotations

import asyncio
import json
import math
import os
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from llm_flock.errors import InputError, MessageError
from llm_flock.extras import require
from llm_flock.members import members

if TYPE_CHECKING:
    import zenoh

ROOT = "llm-flock"
MAX_SEALED_BYTES = 1 << 20  # largest sealed message that is opened [bytes]; protocol messages have a far lower limit

THREADS = "(rx: (worker_threads: 1), net: (handover: tx), acc: (handover: tx), app: (handover: tx))"
"""zenoh's threads: one to receive and one for all else. With more, each message wakes two or three of them."""

KEEP_ALIVES = 4  # signs of life per lease


def settings(
    *, listen: Sequence[str], connect: Sequence[str], lease_s: float, security: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """A peer's configuration, by path; endpoints are like `tcp/127.0.0.1:7447`, and port 0 takes a free one."""
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
        "transport/link/rx/max_message_size": 2 * MAX_SEALED_BYTES,  # else 1 GiB is put together before it is refused
        **(security or {}),
    }


def access_control(allowed: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """Lets members send under their own keys only, by the names in their certificates; all may listen.

    Other messages are dropped on arrival, before this program reads them.
    """
    to_all: list[dict[str, Any]] = [
        {
            "id": "listen",
            "flows": ["ingress", "egress"],
            "messages": ["declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"],
        },
        {"id": "send", "flows": ["egress"], "messages": ["put", "liveliness_token"]},
    ]
    own: list[dict[str, Any]] = [
        {"id": name, "flows": ["ingress"], "messages": ["put", "liveliness_token"], "key_exprs": list(keys)}
        for name, keys in allowed.items()
        if keys
    ]
    return {
        "access_control": {
            "enabled": True,
            "default_permission": "deny",
            "rules": [{"permission": "allow", "key_exprs": ["**"], **rule} for rule in to_all + own],
            "subjects": [{"id": name, "cert_common_names": [name]} for name in allowed],
            "policies": [
                {"rules": ["listen", "send"], "subjects": list(allowed)},
                *({"rules": [rule["id"]], "subjects": [rule["id"]]} for rule in own),
            ],
        }
    }


def open_session(values: Mapping[str, Any]) -> zenoh.Session:
    """Open a session; an InputError if zenoh does not take the configuration (an endpoint that is in use, say)."""
    os.environ.setdefault("ZENOH_RUNTIME", THREADS)
    require("network", "a swarm")
    import zenoh

    config: Any = zenoh.Config()  # its types are unknown in part
    try:
        for path, value in values.items():
            config.insert_json5(path, json.dumps(value))
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise InputError("listen", values.get("listen/endpoints"), f"endpoints that can be opened ({error})") from None


def _straight(take: Callable[[zenoh.Sample], None]) -> Any:
    """A handler that is called in the thread that received a sample, and must be quick."""
    import zenoh

    return zenoh.handlers.Callback(take, indirect=False)


@dataclass(slots=True)
class LinkTraffic:
    """Payloads that one process has sent, each counted once, and those that it refused to open."""

    sent: Counter[str] = field(default_factory=Counter[str])
    bytes: Counter[str] = field(default_factory=Counter[str])
    refused: Counter[str] = field(default_factory=Counter[str])


MAX_TOPICS = 1 << 14  # most topics whose messages are counted; a team of 1,000 has some 4,000
BURST_S = 2.0  # a topic may bring as much at once as it may in this time [s]


class Allowance:
    """How much may come: `rate` messages, or bytes, a second, and as many at once as in `BURST_S`. A token bucket."""

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._left = self._most = max(1.0, BURST_S * rate)
        self._since = -math.inf

    def spend(self, now: float, amount: float = 1.0) -> bool:
        """Count one more message, or this many bytes, at this time [s]; return False, counting nothing, if too many."""
        self._left = min(self._most, self._left + self._rate * max(0.0, now - self._since))
        self._since = now
        if self._left < amount:
            return False
        self._left -= amount
        return True


class Allowances:
    """An allowance for each topic."""

    def __init__(self) -> None:
        self._by_topic: dict[str, Allowance] = {}

    def spend(self, topic: str, rate: float) -> bool:
        """Count one more message under a topic that may bring `rate` a second; whether that is not too many."""
        if topic not in self._by_topic and len(self._by_topic) >= MAX_TOPICS:
            self._by_topic.clear()
        return self._by_topic.setdefault(topic, Allowance(rate)).spend(time.monotonic())


_ID_BYTES = 2


class Seal(Protocol):
    """Seals what one member sends, and opens what others send: the place for signatures."""

    def seal(self, payload: bytes, topic: str) -> bytes:
        """The bytes to send under a topic."""
        ...

    def open(self, sealed: bytes, topic: str) -> tuple[int, bytes]:
        """The member that sent it under this topic, and the payload; a MessageError if it cannot be trusted."""
        ...


class PlainSeal:
    """Names the sender without proof: for networks on which every process is trusted."""

    def __init__(self, sender: int) -> None:
        self._head = sender.to_bytes(_ID_BYTES, "big", signed=True)

    def seal(self, payload: bytes, topic: str) -> bytes:
        return self._head + payload

    def open(self, sealed: bytes, topic: str) -> tuple[int, bytes]:
        if len(sealed) < _ID_BYTES:
            raise MessageError("malformed", "no sender")
        return int.from_bytes(sealed[:_ID_BYTES], "big", signed=True), sealed[_ID_BYTES:]


def sealed_topic(topic: str, contexts: Mapping[str, str]) -> str:
    """The topic with the context of its kind, as a seal covers it."""
    context = contexts.get(topic.partition("/")[0])
    return topic if context is None else f"{topic} {context}"


class ZenohLink:
    """Connects one process to a swarm's network. A topic is `kind/id`; other swarms, and own messages, are ignored.

    A payload is dropped where a receiver does not keep up, or where its topic brings more than `rates` allow: messages
    a second under one topic, by kind, counted as `too_many` before a signature is checked. The seal of a kind with a
    context covers it too. While a handler runs in `loop`, `at_hand` is its sealed message.
    """

    def __init__(
        self,
        session: zenoh.Session,
        *,
        swarm: str,
        own: int,
        seal: Seal,
        loop: asyncio.AbstractEventLoop,
        rates: Mapping[str, float],
        contexts: Mapping[str, str] | None = None,
    ) -> None:
        self.traffic = LinkTraffic()
        self.at_hand = b""
        self._session: Any = session
        self._root = f"{ROOT}/{swarm}"
        self._own = own
        self._seal = seal
        self._loop = loop
        self._rates, self._contexts = rates, contexts or {}
        self._allowances = Allowances()
        self._publishers: dict[str, Any] = {}
        self._kept: list[Any] = []
        self._closed = False
        self._came: deque[tuple[Callable[..., None], tuple[Any, ...]]] = deque()
        self._called = False

    def publish(self, kind: str, number: int, payload: bytes) -> None:
        """Send to every process that listens to `kind` with this number, or with all."""
        topic = f"{kind}/{number}"
        publisher = self._publishers.get(topic)
        if publisher is None:
            import zenoh

            publisher = self._publishers[topic] = self._session.declare_publisher(
                f"{self._root}/{topic}", congestion_control=zenoh.CongestionControl.DROP, express=True
            )
        sealed = self._seal.seal(payload, sealed_topic(topic, self._contexts))
        self.traffic.sent[kind] += 1
        self.traffic.bytes[kind] += len(sealed)
        publisher.put(sealed)

    def listen(self, kind: str, number: int | None, handler: Callable[[int, bytes], None]) -> None:
        """Call the handler in the event loop with sender and payload of each message of a kind, to one number or all.

        A message under another number than its seal's sender is refused, unless the topic is the receiver's (`number`).
        """

        def open_sealed(topic: str, sealed: bytes) -> None:
            named = topic.rpartition("/")[2] if number is None else None
            if self._closed or named == str(self._own):
                return
            try:
                if len(sealed) > MAX_SEALED_BYTES:
                    raise MessageError("oversized", f"{len(sealed)} bytes")
                sender, payload = self._seal.open(sealed, sealed_topic(topic, self._contexts))
                if named not in (None, str(sender)):
                    raise MessageError("wrong_topic", f"{sender} in {kind}")
            except MessageError as error:
                self.traffic.refused[error.reason] += 1
                return
            if sender != self._own:
                self.at_hand = sealed
                handler(sender, payload)

        def take(sample: zenoh.Sample) -> None:
            topic = str(sample.key_expr).removeprefix(f"{self._root}/")
            if self._allowances.spend(topic, self._rates[kind]):
                self._call(open_sealed, topic, sample.payload.to_bytes())
            else:  # only this thread counts them
                self.traffic.refused["too_many"] += 1

        key = f"{self._root}/{kind}/{'*' if number is None else number}"
        self._kept.append(self._session.declare_subscriber(key, _straight(take)))

    def _call(self, function: Callable[..., None], *args: Any) -> None:
        """From a thread of zenoh's: have the event loop call this; many calls wake it once."""
        self._came.append((function, args))
        if self._called or self._closed:
            return
        self._called = True
        try:
            self._loop.call_soon_threadsafe(self._take_all)
        except RuntimeError:  # the loop has ended between the two lines
            self._closed = True

    def _take_all(self) -> None:
        self._called = False  # first: later calls may be left to the next time
        for _ in range(len(self._came)):
            function, args = self._came.popleft()
            self._loop.call_soon(function, *args)

    def declare_alive(self, number: int) -> None:
        self._kept.append(self._session.liveliness().declare_token(f"{self._root}/alive/{number}"))

    def watch_alive(self, n_robots: int, handler: Callable[[int, bool], None]) -> None:
        """Have a handler called when a member of the team comes (True) or goes (False), at once for those there."""
        import zenoh

        known = {str(member): member for member in members(n_robots)}

        def take(sample: zenoh.Sample) -> None:
            member = known.get(str(sample.key_expr).rpartition("/")[2])
            if member is not None:
                self._call(handler, member, sample.kind == zenoh.SampleKind.PUT)

        key = f"{self._root}/alive/*"
        self._kept.append(self._session.liveliness().declare_subscriber(key, _straight(take), history=True))

    def close(self) -> None:
        """Leave the network; harmless when called twice."""
        if not self._closed:
            self._closed = True
            self._session.close()
