"""Stands before Foxglove's server, which takes any client: checks the origin and the token, and admits to orders.

Foxglove's server has no token, and lets the page of any site connect. So it listens at a random loopback address, and
clients come through this gate. The gate adds one message to the connection of a client that showed the token, with a
password that only the gate and the server know: a client that finds a way around the gate gives no orders.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import os
import socket
import threading
from urllib.parse import parse_qsl, urlsplit

from llm_flock.listening import is_loopback

HEAD_BYTES = 16384
HEAD_S = 5.0
"""Size of a request's head [bytes], and longest wait for it [s]."""

SLOW_S = 20.0
"""A client that takes nothing for this long is disconnected [s]."""

BEHIND_S = 0.05
"""What a client says reaches the server after this time [s]. The server announces a channel before it knows it itself:
a client that subscribed at once was told "Unknown channel ID", and never saw the channel."""

MOST_CLIENTS = 32
MOST_WAITING = 64
"""Connections whose request is not there yet; more are closed at once, for a process has few file descriptors."""

MESSAGE_BYTES = 1 << 20
"""Longest message of a client, over all its fragments: the server would keep 64 MiB of one that does not end."""

PIECE_BYTES = 65536
APPS = frozenset({"app.foxglove.dev", "embed.foxglove.dev"})
"""Pages, besides those of this machine, that may connect without a token: Foxglove's own."""


class ClientGate:
    """Passes clients of a listening socket on to a server; runs in a thread of its own until it is closed.

    Args:
        sock: where clients come.
        server: host and port of the server.
        token: what a client must show as `?token=...`; None for none, and then nobody is admitted to orders.
        greeting: the text message that is sent to the server for a client that showed the token.
    """

    def __init__(self, sock: socket.socket, server: tuple[str, int], token: str | None, greeting: str) -> None:
        self._sock = sock
        self._server = server
        self._token = token
        self._greeting = greeting
        self._clients = self._waiting = 0
        self._loop = asyncio.new_event_loop()
        self._ended = asyncio.Event()
        self._thread = threading.Thread(target=self._run, daemon=True, name="foxglove-gate")
        self._thread.start()

    @property
    def clients(self) -> int:
        """Number of clients that are connected."""
        return self._clients

    def close(self) -> None:
        """Disconnect everybody."""
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._ended.set)
        self._thread.join(2.0)

    def _run(self) -> None:
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._loop.close()

    async def _serve(self) -> None:
        listening = await asyncio.start_server(self._meet, sock=self._sock, limit=HEAD_BYTES)
        await self._ended.wait()
        listening.close()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

    async def _meet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One client, from its request to its end."""
        if self._waiting >= MOST_WAITING:
            writer.transport.abort()
            return
        try:
            with contextlib.suppress(OSError, asyncio.IncompleteReadError, TimeoutError, asyncio.CancelledError):
                await self._pass(reader, writer)
        finally:
            writer.transport.abort()

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._waiting += 1
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_S)
        except asyncio.LimitOverrunError:
            await _refuse(writer, "431 Request Header Fields Too Large", "the request is too long")
            return
        finally:
            self._waiting -= 1
        shown, refusal = self._judge(head.decode("latin-1"))
        if refusal is None and self._clients >= MOST_CLIENTS:
            refusal = ("503 Service Unavailable", f"{MOST_CLIENTS} clients are connected")
        if refusal is not None:
            await _refuse(writer, *refusal)
            return
        self._clients += 1
        inner = None
        try:
            inner_reader, inner = await asyncio.open_connection(*self._server)
            inner.write(head)
            answer = await asyncio.wait_for(inner_reader.readuntil(b"\r\n\r\n"), HEAD_S)
            writer.write(answer)
            if shown and self._greeting and answer.startswith(b"HTTP/1.1 101"):
                inner.write(_text_frame(self._greeting))
            ways = {
                asyncio.create_task(_copy(reader, inner, BEHIND_S, MessageLengths())),
                asyncio.create_task(_copy(inner_reader, writer)),
            }
            try:
                await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for way in ways:
                    way.cancel()
                await asyncio.gather(*ways, return_exceptions=True)
        finally:
            self._clients -= 1
            if inner is not None:
                inner.transport.abort()

    def _judge(self, head: str) -> tuple[bool, tuple[str, str] | None]:
        """Whether the token was shown, and why a client is refused; None if it is not."""
        first, *rest = head.split("\r\n")
        words = first.split(" ")
        heads = {name.strip().lower(): value.strip() for name, _, value in (line.partition(":") for line in rest)}
        if len(words) != 3 or words[0] != "GET" or "websocket" not in heads.get("upgrade", "").lower():
            return False, ("426 Upgrade Required", "this address is for Foxglove: open it there as a WebSocket")
        given = dict(parse_qsl(words[1].partition("?")[2])).get("token")
        if self._token is not None:
            if given is not None and hmac.compare_digest(given.encode(), self._token.encode()):
                return True, None
            return False, ("401 Unauthorized", "the address needs its token")
        if _is_foreign(heads.get("origin")):
            return False, ("403 Forbidden", "the page of another site may not connect without a token")
        return False, None


def _is_foreign(origin: str | None) -> bool:
    """Whether a connection comes from the page of a web site that is neither on this machine nor Foxglove's.

    Programs send no origin, or one without a site (file://).
    """
    if origin is None:
        return False
    try:
        parts = urlsplit(origin)
        site = parts.hostname
    except ValueError:
        return True
    if origin == "null":  # a page that hides where it is from
        return True
    return parts.scheme in ("http", "https") and not (site is not None and (site in APPS or is_loopback(site)))


class MessageLengths:
    """Follows the messages in a client's stream (RFC 6455, section 5.2), whose content it does not look at."""

    def __init__(self) -> None:
        self._head = bytearray()
        self._left = self._length = 0  # of this frame's payload still to come, and of this message so far [bytes]

    def take(self, piece: bytes) -> bool:
        """Whether every message is short enough, with the next piece of the stream."""
        at = 0
        while at < len(piece):
            if self._left:
                skipped = min(self._left, len(piece) - at)
                self._left, at = self._left - skipped, at + skipped
                continue
            self._head.append(piece[at])
            at += 1
            if len(self._head) < 2:
                continue
            short = self._head[1] & 0x7F
            extended = {126: 2, 127: 8}.get(short, 0)
            if len(self._head) < 2 + extended + (4 if self._head[1] & 0x80 else 0):
                continue
            length = int.from_bytes(self._head[2 : 2 + extended]) if extended else short
            last, kind = self._head[0] & 0x80, self._head[0] & 0x0F
            self._left = length
            self._head.clear()
            whole = length if kind >= 8 else self._length + length  # control frames come between fragments
            if whole > MESSAGE_BYTES:
                return False
            if kind < 8:
                self._length = 0 if last else whole
        return True


async def _copy(
    reader: asyncio.StreamReader,
    writer: asyncio.StreamWriter,
    behind_s: float = 0.0,
    lengths: MessageLengths | None = None,
) -> None:
    while piece := await reader.read(PIECE_BYTES):
        if lengths is not None and not lengths.take(piece):
            return
        await asyncio.sleep(behind_s)
        writer.write(piece)
        await asyncio.wait_for(writer.drain(), SLOW_S)


async def _refuse(writer: asyncio.StreamWriter, status: str, text: str) -> None:
    body = text.encode()
    head = f"HTTP/1.1 {status}\r\nContent-Type: text/plain\r\nContent-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    writer.write(head.encode() + body)
    await asyncio.wait_for(writer.drain(), HEAD_S)
    writer.close()
    await asyncio.wait_for(writer.wait_closed(), HEAD_S)


def _text_frame(text: str) -> bytes:
    """A WebSocket message as a client sends it (RFC 6455, section 5.2), of at most 125 bytes."""
    data, mask = text.encode(), os.urandom(4)
    assert len(data) <= 125
    return bytes((0x81, 0x80 | len(data))) + mask + bytes(byte ^ mask[k % 4] for k, byte in enumerate(data))


def greeting(name: str, password: str) -> str:
    """The message that admits a client: it sets a parameter that nobody can read."""
    return json.dumps({"op": "setParameters", "parameters": [{"name": name, "value": password}]}, separators=(",", ":"))
