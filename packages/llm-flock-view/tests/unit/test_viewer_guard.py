"""Who may ask a viewer, and what its pages may load."""

from __future__ import annotations

import asyncio
from typing import Any
from urllib.parse import quote

import pytest

from llm_flock.errors import InputError

pytest.importorskip("starlette")

from llm_flock_view._viewer.guard import RequestGuard
from llm_flock_view._viewer.server import listen

HOST = "127.0.0.1:8765"
TOKEN = "correct horse battery"
COOKIE = {"cookie": f"flock_token_8765={quote(TOKEN)}"}


def guarded(token: str = TOKEN) -> RequestGuard:
    return RequestGuard(_inner, token)


async def _inner(scope: Any, receive: Any, send: Any) -> None:
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"inside"})


def ask(
    guard: RequestGuard,
    headers: dict[str, str],
    *,
    path: str = "/",
    query: str = "",
    method: str = "GET",
) -> list[dict[str, Any]]:
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        return {"type": "http.request"}

    async def send(message: Any) -> None:
        sent.append(message)

    scope = {
        "type": "http",
        "method": method,
        "path": path,
        "query_string": query.encode(),
        "server": ("127.0.0.1", 8765),
        "headers": [(name.encode(), value.encode()) for name, value in headers.items()],
    }
    asyncio.run(guard(scope, receive, send))
    return sent


def status(sent: list[dict[str, Any]]) -> int:
    return sent[0]["status"]


def header(sent: list[dict[str, Any]], name: str) -> str | None:
    return next((value.decode() for key, value in sent[0]["headers"] if key.decode() == name), None)


def test_its_own_pages_may_ask_and_may_load_nothing_else() -> None:
    sent = ask(guarded(), {**COOKIE, "host": HOST, "origin": f"http://{HOST}"})
    assert status(sent) == 200
    policy = header(sent, "content-security-policy") or ""
    assert "default-src 'self'" in policy and "http:" not in policy and "*" not in policy


@pytest.mark.parametrize("origin", ["http://evil.example", "http://127.0.0.1:9", "null", f"http://{HOST}.evil.example"])
def test_pages_of_others_may_not_ask(origin: str) -> None:
    guard = guarded()
    assert status(ask(guard, {**COOKIE, "host": HOST, "origin": origin})) == 403


def test_orders_come_from_its_own_pages_only() -> None:
    guard = guarded()
    assert status(ask(guard, {**COOKIE, "host": HOST, "origin": f"http://{HOST}"}, method="POST")) == 200
    assert status(ask(guard, {**COOKIE, "host": HOST}, method="POST")) == 403
    assert status(ask(guard, {**COOKIE, "host": HOST, "origin": "http://evil.example"}, method="POST")) == 403


def test_a_name_that_was_bent_to_this_machine_is_refused() -> None:
    # A browser keeps cookies by the name of a host: that one has none.
    assert status(ask(guarded(), {"host": "evil.example:8765", "origin": "http://evil.example:8765"})) == 401


def test_a_token_is_shown_once_and_then_kept_in_a_cookie() -> None:
    guard = guarded()
    assert status(ask(guard, {"host": HOST})) == 401
    assert status(ask(guard, {"host": HOST}, query="token=wrong")) == 401
    sent = ask(guard, {"host": HOST}, path="//evil.example/x", query="token=correct%20horse%20battery&round=3")
    assert status(sent) == 200 and b'<a href="/evil.example/x?round=3">' in sent[1]["body"]
    assert TOKEN.split()[0] not in str(sent[1]["body"]) and header(sent, "location") is None
    cookie = header(sent, "set-cookie") or ""
    assert "HttpOnly" in cookie and "samesite=strict" in cookie.lower()
    kept = cookie.split(";")[0]
    assert status(ask(guard, {"host": HOST, "cookie": kept})) == 200
    again = ask(guard, {"host": HOST, "cookie": kept}, query=f"token={quote(TOKEN)}")
    assert b'<a href="/">' in again[1]["body"], "the token leaves the address again"
    assert status(ask(guard, {"host": HOST, "cookie": "flock_token_8765=other"})) == 401
    assert status(ask(guard, {"host": HOST, "cookie": "a\x01=;;"})) == 401
    posted = {"host": HOST, "origin": f"http://{HOST}"}
    assert status(ask(guard, posted, query="token=correct%20horse%20battery", method="POST")) == 401
    assert status(ask(guard, {"host": HOST, "cookie": kept.replace("8765", "8766")})) == 401, "another viewer's"


def test_a_person_without_the_token_is_asked_for_it() -> None:
    page = ask(guarded(), {"host": HOST, "accept": "text/html,*/*"}, path="/run/abc", query="token=%3Cscript%3E")
    assert status(page) == 401 and b"Paste the address" in page[1]["body"]
    assert b"<script>" not in page[1]["body"].split(b"</main>")[0], "nothing of the address is in the page"
    assert b"Paste" not in ask(guarded(), {"host": HOST, "accept": "*/*"}, path="/data/runs")[1]["body"]


def test_a_token_has_sixteen_characters() -> None:
    with pytest.raises(InputError, match="16 characters"):
        listen("127.0.0.1", 0, "short")


def test_any_token_is_kept_in_a_cookie() -> None:
    token = 'a b;c="ü€"&%20+,d'
    guard = guarded(token)
    sent = ask(guard, {"host": HOST}, query=f"token={quote(token, safe='')}")
    assert status(sent) == 200
    kept = (header(sent, "set-cookie") or "").split(";")[0]
    assert status(ask(guard, {"host": HOST, "cookie": kept})) == 200
