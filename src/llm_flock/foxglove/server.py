"""A live run for Foxglove: a sink of record entries that serves them by the server of the foxglove-sdk."""

from __future__ import annotations

import contextlib
import logging
import secrets
import sys
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, cast

from llm_flock.foxglove.channels import ARENA, TRAILS, ChannelWriter, channel_kinds
from llm_flock.foxglove.gate import ClientGate, greeting
from llm_flock.foxglove.services import OrderDesk, Orders
from llm_flock.listening import ListeningPort
from llm_flock.record.schema import SCENE_TOPIC, Entry, MissionInfo

if TYPE_CHECKING:
    from foxglove import Channel
    from foxglove.websocket import ChannelView, Client, ServerListener, WebSocketServer


PASS = "pass"
KEPT = frozenset({"/run", "/mission", "/plan", "/summary", ARENA, SCENE_TOPIC, TRAILS})
"""Channels whose last message is sent again to clients that come later."""

BACKLOG = 256
"""Messages that wait for a slow client; three of each robot more. Then the oldest are dropped."""

LINGER_S = 0.5
"""Time for the end of a run to reach the clients [s]."""

NAME = "llm-flock"


logger = logging.getLogger(__name__)


class FoxgloveServer:
    """Serves one run after another on a port that `Service.listen` opens. Write its entries as they happen.

    Attributes:
        url: address to open in Foxglove, with the token.
    """

    def __init__(self, port: ListeningPort, orders: Orders, n_robots: int) -> None:
        import foxglove
        from foxglove.websocket import Capability

        # What a client does wrong is told to the client; it must not fill the terminal.
        logging.getLogger("foxglove").setLevel(logging.CRITICAL)
        token = port.token
        self.url = port.url("ws")
        try:
            self._lock = threading.Lock()
            self._failed = False
            self._context = foxglove.Context()
            self._channels: dict[str, Channel] = {}
            self._kept: dict[str, bytes] = {}
            self._writer = ChannelWriter()
            password = secrets.token_urlsafe(24)
            offered = token is not None and bool(orders)
            self._desk = OrderDesk(orders if offered else Orders(), PASS, password, self._warn)
            self._server: WebSocketServer | None = None
            self._add_channels(n_robots)
            inner = _inner_host()
            self._server = foxglove.start_server(
                name=NAME,
                host=inner,
                port=0,
                capabilities=[Capability.Parameters, Capability.Services] if offered else [],
                server_listener=cast("ServerListener", _Listener(self._desk, self._again)),
                supported_encodings=["json"],
                services=self._desk.services() if offered else [],
                context=self._context,
                message_backlog_size=BACKLOG + 3 * n_robots,
            )
            address = (inner, self._server.port)
            self._gate = ClientGate(port.sock, address, token, greeting(PASS, password) if offered else "")
        except BaseException:
            port.sock.close()
            raise

    def write(self, entry: Entry) -> None:
        """Send an entry, and what is drawn of it, to all clients. Never waits for one, and raises nothing.

        A run must not end because it cannot be shown: after a fault the rest of it is not sent.
        """
        if self._failed:
            return
        try:
            self._send(entry)
        except Exception:
            self._failed = True
            logger.warning("Foxglove does not show the rest of the run", exc_info=True)

    def _send(self, entry: Entry) -> None:
        with self._lock:
            if isinstance(entry, MissionInfo):
                self._add_channels(int(entry.mission["n_robots"]))
                self._desk.mission_given(entry.mission)
            now = time.time_ns()
            for message in self._writer.messages(entry):
                if message.topic in KEPT:
                    self._kept[message.topic] = message.data
                self._channels[message.topic].log(message.data, log_time=now)
        if isinstance(entry, MissionInfo) and self._server is not None:
            self._server.publish_parameter_values(self._desk.parameters())

    def restart(self) -> None:
        """Begin another run: clients forget the last one."""
        with self._lock:
            self._writer, self._kept, self._failed = ChannelWriter(), {}, False
            if self._server is not None:
                self._server.clear_session()

    def close(self) -> None:
        """Disconnect everybody, after what is under way has left."""
        if self._gate.clients:
            time.sleep(LINGER_S)
        self._gate.close()
        server, self._server = self._server, None
        if server is not None:
            server.stop()

    def _add_channels(self, n_robots: int) -> None:
        from foxglove import Channel, Schema

        for topic, kind in channel_kinds(n_robots).items():
            if topic not in self._channels:
                data = _json(kind.schema)
                schema = Schema(name=kind.name, encoding="jsonschema", data=data)
                self._channels[topic] = Channel(topic, schema=schema, message_encoding="json", context=self._context)

    def _again(self, topic: str) -> None:
        """Send the last message of a channel again, to a client that has just come."""
        data = self._kept.get(topic)
        if data is not None:
            self._channels[topic].log(data, log_time=time.time_ns())

    def _warn(self, text: str) -> None:
        from foxglove import StatusLevel

        if self._server is not None:
            self._server.publish_status(text, StatusLevel.Warning)


class _Listener:
    """Passes what clients do on; the SDK asks for one object with all of these methods."""

    def __init__(self, desk: OrderDesk, again: Any) -> None:
        self.on_get_parameters = desk.on_get_parameters
        self.on_set_parameters = desk.on_set_parameters
        self._again = again

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        self._again(channel.topic)

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        pass

    def on_parameters_subscribe(self, param_names: list[str]) -> None:
        pass

    def on_parameters_unsubscribe(self, param_names: list[str]) -> None:
        pass


@contextmanager
def serving(port: ListeningPort, orders: Orders, n_robots: int = 0) -> Generator[FoxgloveServer]:
    """A server until the context is left. Orders are offered only with a token."""
    server = FoxgloveServer(port, orders, n_robots)
    try:
        yield server
    finally:
        with contextlib.suppress(RuntimeError):
            server.close()


def _inner_host() -> str:
    """A loopback address that a page cannot guess, where the system has more than one."""
    if sys.platform != "linux":
        return "127.0.0.1"
    return "127." + ".".join(str(1 + secrets.randbelow(254)) for _ in range(3))


def _json(schema: dict[str, Any]) -> bytes:
    from pydantic_core import to_json

    return to_json(schema)
