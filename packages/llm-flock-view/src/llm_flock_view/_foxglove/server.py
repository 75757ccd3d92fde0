"""A live run for Foxglove: a sink of record entries that serves them by the server of the foxglove-sdk.

It is for reading only, and listens on the loopback interface. The SDK's server checks neither who connects nor the
page that a connection comes from, so it offers no orders.
"""

from __future__ import annotations

import logging
import threading
import time
from typing import TYPE_CHECKING, cast

from pydantic_core import to_json

from llm_flock.errors import FieldError
from llm_flock.extras import require
from llm_flock.record import SCENE_TOPIC, Entry, MissionInfo
from llm_flock_view._foxglove.channels import ARENA, TRAILS, ChannelWriter, channel_kinds

if TYPE_CHECKING:
    from foxglove import Channel
    from foxglove.websocket import ChannelView, Client, ServerListener

HOST = "127.0.0.1"
KEPT = frozenset({"/run", "/mission", "/plan", "/summary", ARENA, SCENE_TOPIC, TRAILS})
"""Channels whose last message is sent again to clients that come later."""

BACKLOG = 256  # messages that wait for a slow client; three of each robot more. Then the oldest are dropped
MAX_SERVED_ROBOTS = 250  # team size for which a server is made whose runs are not known yet
LINGER_S = 0.5  # time for the end of a run to reach the clients [s]

logger = logging.getLogger(__name__)


class FoxgloveServer:
    """Serves one run after another on a `port` (0: a free one). Write its entries as they happen."""

    def __init__(self, port: int, n_robots: int) -> None:
        require("foxglove", "--foxglove")
        import foxglove

        # What a client does wrong is told to the client; it must not fill the terminal.
        logging.getLogger("foxglove").setLevel(logging.CRITICAL)
        self._lock = threading.Lock()
        self._failed = False
        self._context = foxglove.Context()
        self._channels: dict[str, Channel] = {}
        self._kept: dict[str, bytes] = {}
        self._writer = ChannelWriter()
        self._add_channels(n_robots)
        try:
            self._server = foxglove.start_server(
                name="llm-flock",
                host=HOST,
                port=port,
                server_listener=cast("ServerListener", _Listener(self)),
                supported_encodings=["json"],
                context=self._context,
                message_backlog_size=BACKLOG + 3 * n_robots,
            )
        except RuntimeError as error:
            reason = str(error).rpartition(": ")[2]
            says = f"port {port} cannot be used: {reason}; try --foxglove-port 0, which takes a free one"
            raise FieldError("foxglove_port", port, says=says) from None
        self.url = f"ws://{HOST}:{self._server.port}/"

    def write(self, entry: Entry) -> None:
        """Send an entry to all clients; never waits or raises, since a run must not end because it cannot be shown."""
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
            now = time.time_ns()
            for message in self._writer.messages(entry):
                if message.topic in KEPT:
                    self._kept[message.topic] = message.data
                self._channels[message.topic].log(message.data, log_time=now)

    def restart(self) -> None:
        with self._lock:
            self._writer, self._kept, self._failed = ChannelWriter(), {}, False
            self._server.clear_session()

    def send_again(self, topic: str) -> None:
        """Send the last message of a channel again, to a client that has just come."""
        data = self._kept.get(topic)
        if data is not None:
            self._channels[topic].log(data, log_time=time.time_ns())

    def close(self) -> None:
        """Disconnect the clients, after what is under way has left."""
        if any(channel.has_sinks() for channel in self._channels.values()):
            time.sleep(LINGER_S)
        self._server.stop()

    def _add_channels(self, n_robots: int) -> None:
        from foxglove import Channel, Schema

        for topic, kind in channel_kinds(n_robots).items():
            if topic not in self._channels:
                schema = Schema(name=kind.name, encoding="jsonschema", data=to_json(kind.schema))
                self._channels[topic] = Channel(topic, schema=schema, message_encoding="json", context=self._context)


class _Listener:
    """Hears of subscriptions. The SDK calls other methods only for what this server does not offer."""

    def __init__(self, server: FoxgloveServer) -> None:
        self._server = server

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        self._server.send_again(channel.topic)

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        pass
