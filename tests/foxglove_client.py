"""A client of Foxglove's WebSocket protocol, as small as tests need it."""

from __future__ import annotations

import json
import struct
import time
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Self

from websockets.sync.client import connect

PROTOCOL = "foxglove.sdk.v1"
MESSAGE_DATA = 1


class FoxgloveClient:
    """Connects, and keeps what the server says: channels by name, messages and statuses."""

    def __init__(self, url: str) -> None:
        self._stack = ExitStack()
        opened = connect(url, subprotocols=[PROTOCOL], max_size=None)  # type: ignore[list-item]
        self.socket = self._stack.enter_context(opened)
        self.channels: dict[str, dict[str, Any]] = {}
        self.messages: list[tuple[str, dict[str, Any]]] = []
        self.statuses: list[str] = []
        self.info: dict[str, Any] = {}
        self.listen_until(lambda: bool(self.info and "/state" in self.channels))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._stack.close()

    def send(self, **message: Any) -> None:
        self.socket.send(json.dumps(message))

    def subscribe(self, *topics: str) -> None:
        for topic in topics:
            number = self.channels[topic]["id"]
            self.send(op="subscribe", subscriptions=[{"id": number, "channelId": number}])

    def listen_until(self, true: Any, timeout_s: float = 60.0) -> None:
        end = time.monotonic() + timeout_s
        while not true():
            left = end - time.monotonic()
            assert left > 0, "it did not happen"
            self._take(self.socket.recv(timeout=left))

    def listen_for(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            try:
                self._take(self.socket.recv(timeout=left))
            except TimeoutError:
                return

    def of(self, topic: str) -> list[dict[str, Any]]:
        return [message for name, message in self.messages if name == topic]

    def _take(self, data: str | bytes) -> None:
        if isinstance(data, bytes):
            if data[0] == MESSAGE_DATA:
                number = struct.unpack_from("<I", data, 1)[0]
                topic = next(name for name, one in self.channels.items() if one["id"] == number)
                self.messages.append((topic, json.loads(data[13:])))
            return
        message = json.loads(data)
        match message["op"]:
            case "serverInfo":
                self.info = message
            case "advertise":
                self.channels |= {one["topic"]: one for one in message["channels"]}
            case "status":
                self.statuses.append(message["message"])
            case _:
                pass
