"""Nodes, publishers and subscribers in ROS 2's graph: one zenoh session, a client of the router, which forwards.

Others find an entity by its liveliness token. After a loss of the router zenoh declares everything again.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from itertools import count
from typing import TYPE_CHECKING, Any

from llm_flock.errors import InputError, MessageError
from llm_flock.extras import ExtraMissing
from llm_flock_swarm._ros2.types import MAX_BYTES, from_cdr, prepare, to_cdr, type_hash
from llm_flock_swarm._ros2.wire import PUBLISHER, SUBSCRIBER, Attachment, NodeName, gid_of, tokens_of, topic_key
from llm_flock_swarm._zenoh import Allowances, open_session

if TYPE_CHECKING:
    import zenoh

WAIT_MS = 3000  # longest wait for the router at the start [ms]
Handler = Callable[[str, Any, Attachment], None]  # takes the topic, the message and its attachment


class Publisher:
    """Publishes one topic. zenoh gathers messages for a millisecond; an `express` one takes all before it along."""

    def __init__(self, session: Any, key: str, type_name: str, token: str, *, express: bool) -> None:
        import zenoh

        self._type, self._gid, self._count = type_name, gid_of(token), 0
        congestion = zenoh.CongestionControl.DROP
        self._publisher = session.declare_publisher(key, congestion_control=congestion, express=express)

    def publish(self, message: object) -> None:
        """Send a message; it is dropped where the router does not keep up."""
        self.send(to_cdr(message, self._type))

    def send(self, data: bytes) -> None:
        self._count += 1
        attachment = Attachment(self._count, time.time_ns(), self._gid)
        self._publisher.put(data, attachment=attachment.encode())


class Node:
    """A node of the graph. Made by `Graph.node`."""

    def __init__(self, graph: Graph, name: NodeName) -> None:
        self._graph, self._name = graph, name
        graph.be_seen(name.token)

    def publisher(self, topic: str, type_name: str, *, express: bool = False) -> Publisher:
        """A publisher of the topic, by its whole name."""
        token = self._token(PUBLISHER, topic, type_name)
        key = topic_key(self._name.domain, topic, type_name, type_hash(type_name))
        publisher = Publisher(self._graph.session, key, type_name, token, express=express)
        self._graph.be_seen(token)
        return publisher

    def listens(self, topic: str, type_name: str) -> None:
        """Be seen as a subscriber of the topic; `Graph.subscribe` is one."""
        self._graph.be_seen(self._token(SUBSCRIBER, topic, type_name))

    def _token(self, kind: str, topic: str, type_name: str) -> str:
        return self._name.endpoint_token(self._graph.number(), kind, topic, type_name, type_hash(type_name))


class Graph:
    """A process in the graph of a ROS domain. Call in a running event loop; an InputError if no router answers."""

    def __init__(self, router: str, domain: int) -> None:
        prepare()
        values = {
            "mode": "client",
            "connect/endpoints": [router],
            "connect/timeout_ms": WAIT_MS,
            "connect/exit_on_failure": True,
            "scouting/multicast/enabled": False,
        }
        try:
            self.session: Any = open_session(values)
        except ExtraMissing:
            raise
        except InputError:
            starts_one = "ros2 run rmw_zenoh_cpp rmw_zenohd"
            allowed = f"an endpoint such as tcp/127.0.0.1:7447 where a zenoh router answers ({starts_one})"
            raise InputError("ros2", router, allowed) from None
        if not list(self.session.info.routers_zid()):
            self.session.close()
            says = "a zenoh peer answers there, no router: it passes nothing on, and ROS 2 would see no topic"
            raise InputError("ros2", router, says=says)
        self._domain = domain
        self._id = str(self.session.info.zid())
        self._numbers = count()
        self._kept: list[Any] = []
        self._loop = asyncio.get_running_loop()
        self._closed = False

    def number(self) -> int:
        return next(self._numbers)

    def be_seen(self, token: str) -> None:
        """Keep a liveliness token until the end."""
        self._kept.append(self.session.liveliness().declare_token(token))

    def check_free(self, namespace: str, name: str) -> None:
        """Refuse a second node of one name: two bridges of one team would publish every topic twice."""
        if any(reply.ok for reply in self.session.liveliness().get(tokens_of(self._domain, namespace, name))):
            says = "another bridge shows a team by this name there; name another namespace"
            raise InputError("ros_namespace", namespace.removeprefix("/"), says=says)

    def node(self, namespace: str, name: str) -> Node:
        number = self.number()
        named = NodeName(domain=self._domain, session=self._id, number=number, namespace=namespace, name=name)
        return Node(self, named)

    def subscribe(
        self, topic: str, type_name: str, handler: Handler, refuse: Callable[[str, MessageError], None], *, rate: float
    ) -> None:
        """Have a handler called in the event loop with every message of a topic; `$*` in it stands for any text.

        What cannot be read, or is refused with a `MessageError`, goes to `refuse`; so does what comes beyond `rate`
        messages a second under one topic, unread, and from a thread of zenoh's: a flood must not wake the loop.
        """
        import zenoh

        key = topic_key(self._domain, topic, type_name, type_hash(type_name))
        ending = key.removeprefix(f"{self._domain}/{topic.removeprefix('/')}")

        allowances = Allowances()

        def read(name: str, data: bytes, attached: bytes) -> None:
            if self._closed:
                return
            try:
                handler(name, from_cdr(data, type_name), Attachment.decode(attached))
            except MessageError as error:
                refuse(name, error)

        def take(sample: zenoh.Sample) -> None:
            name = "/" + str(sample.key_expr).removeprefix(f"{self._domain}/").removesuffix(ending)
            if not allowances.spend(name, rate):
                refuse(name, MessageError("too_many", f"more than {rate:g} messages a second"))
            elif len(sample.payload) > MAX_BYTES:
                refuse(name, MessageError("oversized", f"{len(sample.payload)} bytes"))
            elif not self._closed:
                attached = b"" if sample.attachment is None else sample.attachment.to_bytes()
                try:
                    self._loop.call_soon_threadsafe(read, name, sample.payload.to_bytes(), attached)
                except RuntimeError:  # the loop has ended
                    self._closed = True

        callback: Any = zenoh.handlers.Callback(take, indirect=False)
        self._kept.append(self.session.declare_subscriber(key, callback))

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self.session.close()
