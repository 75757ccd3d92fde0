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
LEADS_ON = (
    '<!doctype html><link rel="icon" href="data:,"><a href="{}"></a>'
    '<script>location.replace(document.querySelector("a").href + location.hash)</script>'
)
"""What stands behind # is known to the browser alone."""

NEEDED = "This viewer needs the address with its token: open it as `llm-flock view` printed it in its terminal.\n"
ASKS = """<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="color-scheme" content="light dark">
<meta name="viewport" content="width=device-width, initial-scale=1"><title>Token needed · LLM-Flock</title>
<link rel="icon" href="data:,"><style>
body { font: 16px/1.5 system-ui, sans-serif; max-width: 36em; margin: 2em auto; padding: 0 1em; }
input, button { font: inherit; min-height: 44px; padding: 0 8px; width: 100%; box-sizing: border-box; margin-top: 8px; }
</style></head><body><main><h1>This viewer asks for its token</h1>
<p>Paste the address here as `llm-flock view` printed it in its terminal. The page that you asked for follows.</p>
<form><label for="given">Address or token</label><input id="given" autocomplete="off" spellcheck="false" required>
<button>Open</button></form><p role="status"></p></main><script>
const wanted = new URL(location.href);
const wrong = wanted.searchParams.has("token");
document.querySelector("[role]").textContent = wrong ? "This is not the token of this viewer." : "";
document.querySelector("form").addEventListener("submit", (event) => {
  event.preventDefault();
  const given = document.querySelector("input").value.trim();
  wanted.searchParams.set("token", given.includes("token=") ? new URL(given).searchParams.get("token") : given);
  location.replace(wanted);
});
// The token may have been shown in another tab meanwhile.
addEventListener("focus", async () => { if ((await fetch(location.pathname)).ok) location.reload(); });
</script></body></html>
"""
"""For a person: the address that was asked for, with its moment, is kept until the token is there."""


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
        person = asked.method == "GET" and "text/html" in asked.headers.get("accept", "")
        return HTMLResponse(ASKS, 401) if person else PlainTextResponse(NEEDED, 401)

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), self._token.encode())


def _with_headers(send: Send) -> Send:
    async def sends(message: Message) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", ()), *HEADERS]}
        await send(message)

    return sends
