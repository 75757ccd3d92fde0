"""Keys over real sockets: no redirect and no proxy carries them to another server."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from llm_flock.errors import ModelError
from llm_flock.llm._models import ModelPool
from llm_flock.llm._port import Call, ChatMessage

CALL = Call(robot=0, round=0, kind="step", attempt=0, messages=(ChatMessage("user", "Where to?"),))


@contextmanager
def listening(location: str = "") -> Iterator[tuple[str, list[dict[str, str]]]]:
    """A server that redirects, or refuses, everything; its address, and the headers that it got."""
    got: list[dict[str, str]] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            got.append({name.lower(): value for name, value in self.headers.items()})
            self.rfile.read(int(self.headers["Content-Length"]))
            self.send_response(307 if location else 400)
            self.send_header("Location", f"{location}{self.path}")
            self.send_header("Set-Cookie", "follows=me; Path=/")
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", got
    finally:
        server.shutdown()
        server.server_close()


@pytest.mark.parametrize("provider", ["openai", "anthropic"])
def test_a_key_follows_no_redirect_and_no_proxy(provider: str, monkeypatch: pytest.MonkeyPatch) -> None:
    async def ask(url: str) -> None:
        async with ModelPool(environ={f"{provider.upper()}_API_KEY": "sk-secret"}) as pool:
            await pool.model(f"{provider}:a", rng=np.random.default_rng(0), base_urls={provider: url}).ask(CALL)

    with listening() as (other, got), listening(other) as (redirecting, asked):
        for name in ("HTTP_PROXY", "ALL_PROXY", "OPENAI_BASE_URL", "ANTHROPIC_BASE_URL"):
            monkeypatch.setenv(name, other)
        with pytest.raises(ModelError):
            asyncio.run(ask(redirecting))
    assert "sk-secret" in str(asked) and not got


@pytest.mark.parametrize("provider", ["openai", "anthropic", "openai-compatible"])
def test_no_cookie_and_no_variable_goes_to_a_server(provider: str, monkeypatch: pytest.MonkeyPatch) -> None:
    async def ask_twice(url: str) -> None:
        async with ModelPool(environ={}) as pool:
            for _ in range(2):
                with pytest.raises(ModelError, match="refused"):
                    await pool.model(f"{provider}:a", rng=np.random.default_rng(0), base_urls={provider: url}).ask(CALL)

    for name in ("CUSTOM_HEADERS", "AUTH_TOKEN", "API_KEY", "ORG_ID", "PROJECT_ID", "ADMIN_KEY"):
        for sdk in ("OPENAI", "ANTHROPIC"):
            monkeypatch.setenv(f"{sdk}_{name}", "Authorization: sk-secret" if name == "CUSTOM_HEADERS" else "sk-secret")
    with listening() as (url, got):
        asyncio.run(ask_twice(url))
    assert len(got) == 4 and "sk-secret" not in str(got) and "cookie" not in str(got[1:])  # each is asked once more
    assert os.environ["OPENAI_CUSTOM_HEADERS"] and os.environ["ANTHROPIC_ORG_ID"]
