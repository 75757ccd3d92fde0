"""Access control: origin of every request, a token, and a content security policy."""

from __future__ import annotations

import hmac
from html import escape
from urllib.parse import quote, unquote, urlencode

from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

POLICY = "; ".join(
    (
        "default-src 'self'",
        "script-src 'self' 'unsafe-inline'",  # a page's one script is in the page
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
"""A page may load from this server only, so no answer of a model can make it send a request elsewhere."""

HEADERS = (
    (b"content-security-policy", POLICY.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
)
LEADS_ON = '<!doctype html><link rel="icon" href="data:,"><meta http-equiv="refresh" content="0;url={}">'
NEEDED = "This viewer needs the address with its token: open it as `llm-flock view` printed it in its terminal.\n"


class RequestGuard:
    """Middleware that refuses requests which do not come from the viewer's own pages.

    A browser must show the token once, then has a cookie, named by the port: browsers send the cookies of one viewer to
    all others on the same machine. Another site can point its own name at this machine, but has no cookie.
    """

    def __init__(self, app: ASGIApp, token: str) -> None:
        self._app = app
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        asked = self._app if scope["type"] != "http" else self._refusal(Request(scope)) or self._app
        await asked(scope, receive, _with_headers(send))

    def _refusal(self, asked: Request) -> Response | None:
        host, origin = asked.headers.get("host", "").lower(), asked.headers.get("origin")
        if origin is not None and origin.lower() not in (f"http://{host}", f"https://{host}"):
            return PlainTextResponse("another site's page may not ask", status_code=403)
        # Every page's order names its origin; what names none comes from no page.
        if origin is None and asked.method not in ("GET", "HEAD"):
            return PlainTextResponse("no origin", status_code=403)
        cookie = f"flock_token_{asked.scope['server'][1]}"
        given = asked.query_params.get("token", "")
        if asked.method == "GET" and self._is_token(given):
            rest = urlencode([(name, value) for name, value in asked.query_params.multi_items() if name != "token"])
            # Two slashes at the beginning of a path would name another server.
            target = "/" + quote(asked.scope["path"].lstrip("/\\")) + (f"?{rest}" if rest else "")
            # Addresses are copied, logged and kept in histories, so the token is taken out of this one. A page does
            # it: browsers send no cookie along a redirect, where another page linked here.
            answer = HTMLResponse(LEADS_ON.format(escape(target)))
            answer.set_cookie(cookie, quote(given, safe=""), httponly=True, samesite="strict", path="/")
            return answer
        if self._is_token(unquote(asked.cookies.get(cookie, ""))):
            return None
        return PlainTextResponse(NEEDED, 401)

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), self._token.encode())


def _with_headers(send: Send) -> Send:
    async def sends(message: Message) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", ()), *HEADERS]}
        await send(message)

    return sends
