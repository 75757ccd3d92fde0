"""An OpenAI-compatible server that misbehaves on purpose: late, 429, 500, cut connections, garbage.

Runs as a process of its own and answers by a simulated stand-in from nothing but the prompt:

    python tests/integration/fault_server.py --latency 0.02 --rate-limit 0.1 --server-error 0.1 --seed 1

It prints `PORT <number>` once it listens. `GET /stats` returns how often each thing was sent. Tests start it by
`with running(rate_limit=0.1) as server: ...`.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import http.server
import json
import math
import os
import subprocess
import sys
import threading
import urllib.request
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from llm_flock.errors import FlockError

Answer = Callable[[str, list[tuple[str, str]]], str]
"""The answer of a model, by its name, to the messages of a conversation."""

FAULTS = ("late", "rate_limit", "server_error", "cut", "garbage")
REFUSALS = {
    "system": "jinja: system role is not supported by this template",
    "turns": "Conversation roles must alternate user/assistant/user/assistant/...",
    "response_format": "response_format of this type is not available on this server",
    "max_tokens": "Unsupported parameter: 'max_tokens' is not known to this model. Use 'max_completion_tokens'.",
    "temperature": "Unsupported value: 'temperature' takes only the default (1) with this model.",
    "seed": "Unrecognized request argument supplied: seed",
    "reasoning_effort": "extra fields not permitted: reasoning_effort",
}
"""What a server may refuse in a request that is right, and how real ones say so."""

GARBAGE = ("html", "broken_json", "wrong_shape", "unusable")
"""What garbage is sent, in turn. The first three are no chat completion; `unusable` is one, with a useless text."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """Rates are shares of requests in [0, 1] and must add up to at most 1; times are in seconds.

    Models whose name begins with `bad` answer by `bad_profile`: who asks such a model has a bad one for the whole run.
    """

    port: int = 0
    latency: float = 0.0
    late: float = 0.0
    late_latency: float = 5.0
    rate_limit: float = 0.0
    retry_after: float = 0.05
    server_error: float = 0.0
    cut: float = 0.0
    garbage: float = 0.0
    seed: int = 0
    profile: str = "ideal"
    bad_profile: str = "ideal"
    fixed_answer: str = ""
    refuses: str = ""


class Faults:
    """Draws what happens to each request, and keeps count."""

    def __init__(self, options: Options) -> None:
        rates = [getattr(options, name) for name in FAULTS]
        if min(rates) < 0 or sum(rates) > 1:
            raise SystemExit("rates must be at least 0 and add up to at most 1")
        self.bounds = np.cumsum(rates).tolist()
        self.rng = np.random.default_rng(options.seed)
        self.counts: Counter[str] = Counter()

    def draw(self) -> str:
        x = self.rng.random()
        name = next((name for name, bound in zip(FAULTS, self.bounds, strict=True) if x < bound), "ok")
        self.counts["requests"] += 1
        self.counts[name] += 1
        if name == "garbage":
            name = GARBAGE[(self.counts["garbage"] - 1) % len(GARBAGE)]
            self.counts[name] += 1
        return name


class Connection(asyncio.Protocol):
    """One keep-alive connection. A protocol with timers instead of a task a request: 1,000 of them are cheap."""

    def __init__(self, options: Options, faults: Faults, answer: Answer) -> None:
        self.options = options
        self.faults = faults
        self.answer = answer
        self.buffer = b""
        self.transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport
        counts = self.faults.counts
        counts["connections"] += 1
        counts["open"] += 1
        counts["most_open"] = max(counts["most_open"], counts["open"])

    def connection_lost(self, exc: Exception | None) -> None:
        self.transport = None
        self.faults.counts["open"] -= 1

    def data_received(self, data: bytes) -> None:
        self.buffer += data
        while (end := self.buffer.find(b"\r\n\r\n")) >= 0:
            head = self.buffer[:end].decode("latin-1").split("\r\n")
            length = next((int(h.split(":")[1]) for h in head if h.lower().startswith("content-length:")), 0)
            if len(self.buffer) < end + 4 + length:
                return
            body = self.buffer[end + 4 : end + 4 + length]
            self.buffer = self.buffer[end + 4 + length :]
            self.handle(head[0], body)

    def handle(self, request: str, body: bytes) -> None:
        method, path, _ = request.split(" ")
        if method == "GET" and path == "/stats":
            self.send(200, json.dumps(self.faults.counts).encode())
        elif method == "POST" and path == "/v1/chat/completions":
            fault = self.faults.draw()
            delay = self.options.late_latency if fault == "late" else self.options.latency
            if delay > 0:
                asyncio.get_running_loop().call_later(delay, self.respond, fault, body)
            else:
                self.respond(fault, body)
        else:
            self.send(404, b'{"error": {"message": "no such path"}}')

    def respond(self, fault: str, body: bytes) -> None:
        if self.options.refuses and refused(self.options.refuses, json.loads(body)):
            self.faults.counts["refused"] += 1
            self.send(400, json.dumps({"error": {"message": REFUSALS[self.options.refuses]}}).encode())
            return
        match fault:
            case "rate_limit":
                wait = self.options.retry_after
                extra = f"Retry-After: {math.ceil(wait)}\r\n"
                if wait != math.ceil(wait):
                    extra += f"retry-after-ms: {wait * 1000:g}\r\n"
                self.send(429, b'{"error": {"message": "slow down", "code": "rate_limit_exceeded"}}', extra)
            case "server_error":
                self.send(500, b'{"error": {"message": "the server stumbled"}}')
            case "cut":
                self.cut(body)
            case "html":
                self.send(200, b"<html><body>Bad gateway</body></html>", kind="text/html")
            case "broken_json":
                self.send(200, b'{"id": "x", "choices": [{"mess')
            case "wrong_shape":
                self.send(200, b'{"choices": [], "surprise": true}')
            case "unusable":
                self.send(200, completion(body, "As a robot I would rather talk about the weather."))
            case _:
                try:
                    asked = json.loads(body)
                    messages = [(m["role"], text_of(m["content"])) for m in asked["messages"]]
                    if messages[0][0] == "user":  # the first message says what a system message would
                        messages.insert(0, ("system", messages[0][1]))
                    self.send(200, completion(body, self.answer(asked["model"], messages)))
                except (FlockError, ValueError, LookupError) as error:
                    self.faults.counts["not_understood"] += 1
                    self.send(400, json.dumps({"error": {"message": repr(error)}}).encode())

    def send(self, status: int, body: bytes, extra: str = "", kind: str = "application/json") -> None:
        if self.transport is None:  # the client gave up waiting
            self.faults.counts["abandoned"] += 1
            return
        head = f"HTTP/1.1 {status} X\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\n{extra}\r\n"
        self.transport.write(head.encode() + body)

    def cut(self, body: bytes) -> None:
        """Break off: every second time before the first byte, otherwise in the middle of the answer."""
        if self.transport is None:
            return
        if self.faults.counts["cut"] % 2:
            text = completion(body, "Position: [50.0, 50.0]")
            head = f"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: {len(text)}\r\n\r\n"
            self.transport.write(head.encode() + text[: len(text) // 2])
            self.transport.close()
        else:
            self.transport.abort()


def refused(what: str, asked: dict[str, Any]) -> bool:
    """Whether a request holds what a server refuses, one of REFUSALS."""
    roles = [message["role"] for message in asked["messages"]]
    match what:
        case "system":
            return "system" in roles
        case "turns":
            return roles != ["assistant" if number % 2 else "user" for number in range(len(roles))]
        case _:
            return what in asked


def text_of(content: str | list[dict[str, str]]) -> str:
    """A message's content may be a text or a list of parts."""
    return content if isinstance(content, str) else "\n".join(part.get("text", "") for part in content)


def completion(request: bytes, text: str, reason: str = "stop", **message: Any) -> bytes:
    """A chat completion in OpenAI's form, with more fields of its message; tokens are a quarter of the characters."""
    sent, said = math.ceil(len(request) / 4), math.ceil(len(text) / 4)
    return json.dumps(
        {
            "id": "chatcmpl-0",
            "object": "chat.completion",
            "created": 1,
            "model": "stand-in",
            "choices": [
                {"index": 0, "finish_reason": reason, "message": {"role": "assistant", "content": text, **message}},
            ],
            "usage": {"prompt_tokens": sent, "completion_tokens": said, "total_tokens": sent + said},
        }
    ).encode()


def stand_in(options: Options) -> Answer:
    """Who answers: a fixed text, or a simulated model that reads the prompt; the same prompt has the same answer."""
    if options.fixed_answer:
        return lambda model, messages: options.fixed_answer
    from llm_flock.llm._simulated.model import SimulatedModel
    from llm_flock.llm._simulated.profiles import parse_profile

    good, bad = parse_profile(options.profile), parse_profile(options.bad_profile)

    def answer(model: str, messages: list[tuple[str, str]]) -> str:
        chance = np.random.default_rng([options.seed, zlib.crc32(repr(messages).encode())])
        return SimulatedModel(bad if model.startswith("bad") else good, chance).answer(messages)

    return answer


async def serve(options: Options) -> None:
    """Listen until the process is ended."""
    faults, answer = Faults(options), stand_in(options)
    loop = asyncio.get_running_loop()
    server = await loop.create_server(
        lambda: Connection(options, faults, answer), "127.0.0.1", options.port, backlog=1024
    )
    print(f"PORT {server.sockets[0].getsockname()[1]}", flush=True)
    async with server:
        await server.serve_forever()


@dataclass(frozen=True, slots=True)
class Server:
    """A running server, seen from a test."""

    port: int

    @property
    def base_url(self) -> str:
        return f"http://127.0.0.1:{self.port}/v1"

    def stats(self) -> dict[str, int]:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.port}/stats", timeout=10) as response:
            return json.loads(response.read())


@contextlib.contextmanager
def running(**options: Any) -> Iterator[Server]:
    """Start the server in its own process with these `Options`; it ends with the block, or with the test process."""
    source = os.pathsep.join(map(str, Path(__file__).parents[2].glob("packages/*/src")))
    command = [sys.executable, __file__, "--end-with-stdin"]
    for name, value in options.items():
        command += [f"--{name.replace('_', '-')}", str(value)]
    path = os.pathsep.join(filter(None, [str(source), os.environ.get("PYTHONPATH")]))
    with subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
    ) as process:
        assert process.stdout is not None
        try:
            line = process.stdout.readline().split()
            if line[:1] != ["PORT"]:
                raise RuntimeError(f"the fault server did not start: {line}")
            yield Server(int(line[1]))
        finally:
            process.kill()


@contextlib.contextmanager
def answering(
    body: bytes, repeat: int = 1, status: int = 200, **headers: str
) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """A server in a thread that gives one response to all; yields its address and the requests as they come.

    The body is sent `repeat` times in one response. Each request gets a field `sent`: how many times that was done.
    """
    seen: list[dict[str, Any]] = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            seen.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(status)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(body) * repeat))
            for name, value in headers.items():
                self.send_header(name.replace("_", "-"), value)
            self.end_headers()
            with contextlib.suppress(ConnectionError):
                for number in range(repeat):
                    self.wfile.write(body)
                    seen[-1]["sent"] = number + 1

        def log_message(self, format: str, *args: Any) -> None:
            """Stay quiet."""

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}/v1", seen
        finally:
            server.shutdown()
            thread.join()


def end_with_stdin() -> None:
    """End this process when the one that started it is gone."""

    def wait() -> None:
        sys.stdin.read()
        os._exit(0)

    threading.Thread(target=wait, daemon=True).start()


def main() -> None:
    """Read the command line and serve."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in ((name, getattr(Options(), name)) for name in Options.__slots__):
        parser.add_argument(f"--{name.replace('_', '-')}", type=type(default), default=default)
    parser.add_argument("--end-with-stdin", action="store_true")
    arguments = vars(parser.parse_args())
    if arguments.pop("end_with_stdin"):
        end_with_stdin()
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(serve(Options(**arguments)))


if __name__ == "__main__":
    main()
