"""Keeps strangers out: host and origin of every request and WebSocket, a token, and what a page may load."""

from __future__ import annotations

import hmac
from collections.abc import Iterable
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qsl, urlencode

from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

POLICY = "; ".join(
    (
        "default-src 'self'",
        "script-src 'self' 'unsafe-inline' 'unsafe-eval'",  # Vue compiles templates in the page
        "style-src 'self' 'unsafe-inline'",
        "img-src 'self' data: blob:",
        "font-src 'self' data:",
        "connect-src 'self'",
        "object-src 'none'",
        "base-uri 'none'",
        "form-action 'self'",
        "frame-ancestors 'none'",
    )
)
"""What a page may load: nothing but what this server gives. So no answer of a model can make it ask elsewhere."""

HEADERS = (
    (b"content-security-policy", POLICY.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
)
POLICY_VIOLATED = 1008
"""WebSocket close code of RFC 6455, section 7.4.1."""


class Guard:
    """Refuses what does not come from the viewer's own pages.

    Args:
        app: what is guarded.
        hosts: names and ports under which the viewer is asked for, such as 127.0.0.1:8080. A page of another site can
            have its own name point to this machine; it cannot change the Host that is sent. Empty: any.
        token: what a browser has to show once; None for nothing.
    """

    def __init__(self, app: ASGIApp, *, hosts: Iterable[str] = (), token: str | None = None) -> None:
        self._app = app
        self._hosts = frozenset(host.lower() for host in hosts)
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request, WebSocket or life span."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        refused = self._refused(scope, headers)
        if refused is None:
            await self._app(scope, receive, _with_headers(send))
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": POLICY_VIOLATED})
        else:
            await refused(scope, receive, _with_headers(send))

    def _refused(self, scope: Scope, headers: dict[str, str]) -> Response | None:
        host = headers.get("host", "").lower()
        if self._hosts and host not in self._hosts:
            return PlainTextResponse("unknown host", status_code=421)
        origin = headers.get("origin")
        if origin is not None and origin.lower() not in (f"http://{host}", f"https://{host}"):
            return PlainTextResponse("another site's page may not ask", status_code=403)
        if scope["type"] == "websocket" and origin is None:
            return PlainTextResponse("no origin", status_code=403)
        if self._token is None:
            return None
        if self._shown(_cookie(headers.get("cookie", ""), self.cookie)):
            return None
        query = parse_qsl(scope.get("query_string", b"").decode("latin-1"))
        if scope["type"] == "http" and scope["method"] == "GET" and self._shown(dict(query).get("token")):
            rest = urlencode([(name, value) for name, value in query if name != "token"])
            # The address of the page does not keep the token: addresses are copied, logged and remembered.
            answer = RedirectResponse(_local(scope["path"]) + (f"?{rest}" if rest else ""), status_code=303)
            answer.set_cookie(self.cookie, self._token, httponly=True, samesite="strict", path="/")
            return answer
        return PlainTextResponse("This viewer needs the address with its token, as the command printed it.", 401)

    @property
    def cookie(self) -> str:
        """Name of the cookie that holds the token."""
        return "flock_token"

    def _shown(self, given: str | None) -> bool:
        return (
            given is not None and self._token is not None and hmac.compare_digest(given.encode(), self._token.encode())
        )


def _local(path: str) -> str:
    """A path of this server: two slashes at its beginning would name another one."""
    return "/" + path.lstrip("/\\")


def _cookie(text: str, name: str) -> str | None:
    try:
        found = SimpleCookie(text).get(name)
    except CookieError:
        return None
    return None if found is None else found.value


def _with_headers(send: Send) -> Send:
    async def sends(message: Message) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", ()), *HEADERS]}
        await send(message)

    return sends
