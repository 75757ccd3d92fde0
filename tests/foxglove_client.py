"""A client of Foxglove's WebSocket protocol, as small as tests need it."""

from __future__ import annotations

import itertools
import json
import struct
import time
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Self

from websockets.sync.client import connect

PROTOCOL = "foxglove.sdk.v1"
MESSAGE_DATA, SERVICE_REQUEST, SERVICE_RESPONSE = 1, 2, 3


class FoxgloveClient:
    """Connects, and keeps what the server says: channels and services by name, parameters, messages, answers."""

    def __init__(self, url: str, origin: str | None = None) -> None:
        self._stack = ExitStack()
        opened = connect(url, subprotocols=[PROTOCOL], origin=origin, max_size=None)  # type: ignore[arg-type]
        self.socket = self._stack.enter_context(opened)
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, dict[str, Any]] = {}
        self.parameters: dict[str, Any] = {}
        self.messages: list[tuple[str, dict[str, Any]]] = []
        self.statuses: list[str] = []
        self.info: dict[str, Any] = {}
        self.answers: dict[int, Any] = {}
        self._calls = itertools.count(1)
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

    def call(self, service: str, request: Any) -> Any:
        """The answer of a service: its response, or the text of its refusal."""
        number = next(self._calls)
        head = struct.pack("<BIII", SERVICE_REQUEST, self.services[service]["id"], number, 4)
        self.socket.send(head + b"json" + json.dumps(request).encode())
        self.listen_until(lambda: number in self.answers)
        return self.answers[number]

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
            elif data[0] == SERVICE_RESPONSE:
                _, call, length = struct.unpack_from("<III", data, 1)
                self.answers[call] = json.loads(data[13 + length :])
            return
        message = json.loads(data)
        match message["op"]:
            case "serverInfo":
                self.info = message
            case "advertise":
                self.channels |= {one["topic"]: one for one in message["channels"]}
            case "advertiseServices":
                self.services |= {one["name"]: one for one in message["services"]}
            case "parameterValues":
                self.parameters |= {one["name"]: one.get("value") for one in message["parameters"]}
            case "serviceCallFailure":
                self.answers[message["callId"]] = message["message"]
            case "status":
                self.statuses.append(message["message"])
            case _:
                pass
