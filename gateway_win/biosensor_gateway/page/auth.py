"""Authenticates requests: from the browser that the program has opened, and from experiments.

Any web page that a person visits can send requests to this computer, and so can any program on it.
Therefore a request must have this server's address as its Host (against DNS rebinding), an allowed
Origin, and a secret that only the program gives away: a cookie, or the token of web experiments.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Callable, Collection, Iterable, Mapping
from http.cookies import CookieError, SimpleCookie
from typing import Any, Literal, NamedTuple

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

DOOR = "/door"
MARKERS = "/api/v1/markers"
"""Path at which web experiments post markers; their WebSocket is below it."""
MAX_BODY = 64 * 1024
MAX_SOCKETS = 32
"""Browser windows at a time."""
MAX_EXPERIMENT_BODY = 4096
MAX_EXPERIMENT_SOCKETS = 16
OPENS_ONCE = (
    "This address opens once. Open the page again: on Windows by Biosensor Gateway in the Start "
    "menu, elsewhere by the command biosensor-gateway page."
)
REFUSED_SOCKET = 1008
"""Code with which a refused WebSocket is closed."""
_TOKENS_KEPT = 16
_PREFLIGHT_HOLDS_S = 600
_BEARER = "bearer "
_GO_ON = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<meta http-equiv="refresh" content="0;url=/">
<title>Biosensor Gateway</title>
<p><a href="/">Open the page</a></p>
</html>
"""
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; "
        "form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Refusal(NamedTuple):
    """The refusal of a request: an HTTP status code, and a sentence for people."""

    code: int
    sentence: str


def is_same(given: str, secret: str) -> bool:
    """Compare secrets in constant time."""
    return hmac.compare_digest(given.encode(errors="replace"), secret.encode())


class Keys:
    """Secrets that open the page: tokens for one use, and the cookie that replaces them."""

    # SameSite attribute of the cookie: whether browsers send it with links on other pages.
    same_site: Literal["lax", "strict"] = "strict"

    def __init__(self, port: int, on_spent: Callable[[str], None] = lambda _: None) -> None:
        # With the port in its name, because browsers send a cookie to every port of a computer.
        self.cookie_name = f"biosensor_gateway_{port}"
        self._cookie = secrets.token_urlsafe(32)
        self._tokens: list[str] = []
        self._on_spent = on_spent

    def new_token(self) -> str:
        """Make a token that opens the page once."""
        token = secrets.token_urlsafe(32)
        self._tokens.append(token)
        if len(self._tokens) > _TOKENS_KEPT:
            self._spend(self._tokens[0])
        return token

    def cookie_for(self, token: str) -> str | None:
        """Use up a token, and return the cookie; None if the token is wrong or used."""
        for known in self._tokens:
            if is_same(token, known):
                self._spend(known)
                return self._cookie
        return None

    def _spend(self, token: str) -> None:
        self._tokens.remove(token)
        self._on_spent(token)

    def fits(self, cookie: str) -> bool:
        """Whether a cookie is the right one."""
        return is_same(cookie, self._cookie)


class ViewKeys(Keys):
    """Secrets of the view for other computers: its token is valid until the server ends.

    The view changes nothing, so that links from other pages and from e-mails may open it.
    """

    same_site = "lax"

    def __init__(self, port: int) -> None:
        super().__init__(port)
        self.token = secrets.token_urlsafe(16)

    def cookie_for(self, token: str) -> str | None:
        """Return the cookie; None for a token that is wrong."""
        return self._cookie if is_same(token, self.token) else None


class BrowserRules:
    """Rules for the page, on this computer or on another one: a cookie, and its own origins.

    Both classes of rules refuse requests of other pages (`foreign`) and requests without the secret
    (`stranger`), and answer requests for the authentication itself (`answer`).

    Parameters
    ----------
    origins
        Addresses of the server, such as ``http://127.0.0.1:1234``.
    """

    max_body = MAX_BODY
    max_sockets = MAX_SOCKETS

    def __init__(self, origins: Iterable[str], keys: Keys, refused: str) -> None:
        self._keys, self._refused = keys, refused
        self._origins = frozenset(origins)
        self.hosts = {each.partition("://")[2] for each in self._origins}
        self._is_secure = all(each.startswith("https:") for each in self._origins)

    def foreign(self, path: str, headers: Headers, *, needs_origin: bool) -> Refusal | None:
        """Refuse a request from another web page."""
        origin = headers.get("origin")
        if origin not in self._origins and (needs_origin or origin is not None):
            return Refusal(
                403, "Another web page sent this request; only the program's own page may send it."
            )
        # The file by which `system.browser` opens the door counts as another page.
        may_link = self._keys.same_site == "lax" or path == DOOR
        is_link = may_link and headers.get("sec-fetch-mode") == "navigate"
        if not is_link and _is_of_another_page(headers):
            return Refusal(
                403, "Another web page sent this request; only the program's own page may send it."
            )
        return None

    def stranger(self, headers: Headers, *, is_socket: bool) -> Refusal | None:
        """Refuse a request without the cookie, or with a wrong one."""
        try:
            cookies = SimpleCookie(headers.get("cookie", ""))
        except CookieError:
            cookies = SimpleCookie()
        cookie = cookies.get(self._keys.cookie_name)
        if cookie is None or not self._keys.fits(cookie.value):
            return Refusal(401, self._refused)
        return None

    def answer(self, request: Request) -> Response | None:
        """Exchange a token for the cookie, at the path `DOOR`."""
        if request.scope["path"] != DOOR:
            return None
        cookie = self._keys.cookie_for(request.query_params.get("token", ""))
        if cookie is None:
            return PlainTextResponse(self._refused + "\n", 403)
        # After a link from another page, browsers send no strict cookie with what a redirect leads
        # to, but they do after a link from this answer.
        needs_own_link = self._keys.same_site == "strict" and _is_of_another_page(request.headers)
        response = HTMLResponse(_GO_ON) if needs_own_link else RedirectResponse("/", 303)
        response.set_cookie(
            self._keys.cookie_name,
            cookie,
            path="/",
            secure=self._is_secure,
            httponly=True,
            samesite=self._keys.same_site,
        )
        return response

    def has_body(self, method: str) -> bool:
        """Whether requests with this method change something, and have a body."""
        return method not in {"GET", "HEAD"}

    def headers_for(self, headers: Headers) -> Mapping[str, str]:
        """Add nothing."""
        return {}


class ExperimentRules:
    """Rules for web experiments: the origins of the settings, and a token.

    Parameters
    ----------
    port
        Port of the server, on the loopback address.
    token
        Needed by each request. A WebSocket sends it in its first message, because scripts cannot
        set its headers.
    """

    max_body = MAX_EXPERIMENT_BODY
    max_sockets = MAX_EXPERIMENT_SOCKETS

    def __init__(
        self, port: int, origins: Collection[str], token: str, on_foreign: Callable[[str], None]
    ) -> None:
        self.hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        self._origins = frozenset(origins)
        self._token = token
        self._on_foreign = on_foreign

    def foreign(self, path: str, headers: Headers, *, needs_origin: bool) -> Refusal | None:
        """Refuse a request without an origin, or from one that the settings do not name."""
        origin = headers.get("origin")
        if origin in self._origins:
            return None
        if origin is None:
            return Refusal(
                403, "Only web pages can send markers here: their browser names an Origin."
            )
        self._on_foreign(origin)
        return Refusal(403, "This origin is not listed in origins under [markers.web].")

    def stranger(self, headers: Headers, *, is_socket: bool) -> Refusal | None:
        """Refuse a request without the token, or with a wrong one."""
        given = headers.get("authorization", "")
        if is_socket:
            return None
        if given[: len(_BEARER)].lower() == _BEARER:
            token = given[len(_BEARER) :].strip()
            if is_same(token, self._token):
                return None
        return Refusal(401, "The token is wrong; biosensor-gateway mark --web shows the right one.")

    def answer(self, request: Request) -> Response | None:
        """Answer a browser's CORS preflight request."""
        if request.method != "OPTIONS" or request.scope["path"] != MARKERS:
            return None
        allowed: dict[str, Any] = {
            "Access-Control-Allow-Methods": "POST",
            "Access-Control-Allow-Headers": "Authorization, Content-Type",
            "Access-Control-Max-Age": str(_PREFLIGHT_HOLDS_S),
        }
        # Browsers ask for this before a public page may reach this computer.
        if request.headers.get("access-control-request-private-network") == "true":
            allowed["Access-Control-Allow-Private-Network"] = "true"
        return Response(status_code=204, headers=allowed)

    def has_body(self, method: str) -> bool:
        """Whether requests with this method have a marker as body."""
        return method == "POST"

    def headers_for(self, headers: Headers) -> Mapping[str, str]:
        """Allow the page to read the answer, also a refusal."""
        # Never '*', and no Allow-Credentials, because cookies are not used here.
        return {"Access-Control-Allow-Origin": headers["origin"], "Vary": "Origin"}


class Guard:
    """Checks every request and WebSocket by rules before the application sees it."""

    def __init__(self, app: ASGIApp, rules: BrowserRules | ExperimentRules) -> None:
        self._app, self._rules = app, rules
        self._open_sockets = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it with a sentence."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await self._socket(scope, receive, send)
        else:
            await self._request(scope, receive, send)

    async def _socket(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = Headers(scope=scope)
        refusal = self._foreign(scope["path"], headers, needs_origin=True)
        refusal = refusal or self._rules.stranger(headers, is_socket=True)
        if refusal is not None or self._open_sockets >= self._rules.max_sockets:
            await receive()
            await send({"type": "websocket.close", "code": REFUSED_SOCKET})
            return
        self._open_sockets += 1
        try:
            await self._app(scope, receive, send)
        finally:
            self._open_sockets -= 1

    async def _request(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers, rules = Headers(scope=scope), self._rules
        has_body = rules.has_body(scope["method"])
        refusal = self._foreign(scope["path"], headers, needs_origin=has_body)
        if refusal is not None:
            # Without CORS headers, so that the browser hides the answer from the page.
            await _refused(refusal)(scope, receive, with_headers(send, {}))
            return
        shown = with_headers(send, rules.headers_for(headers))
        if (answer := rules.answer(Request(scope))) is not None:
            await answer(scope, receive, shown)
            return
        refusal = rules.stranger(headers, is_socket=False)
        if refusal is None and has_body:
            refusal = _body_refusal(headers, rules.max_body)
        await (self._app if refusal is None else _refused(refusal))(scope, receive, shown)

    def _foreign(self, path: str, headers: Headers, *, needs_origin: bool) -> Refusal | None:
        if headers.get("host", "") not in self._rules.hosts:
            return Refusal(421, "This server was addressed by a name that is not its own.")
        return self._rules.foreign(path, headers, needs_origin=needs_origin)


def _is_of_another_page(headers: Headers) -> bool:
    """Whether the browser reports that the request comes from another page."""
    return headers.get("sec-fetch-site", "none") not in {"same-origin", "none"}


def _refused(refusal: Refusal) -> Response:
    return PlainTextResponse(refusal.sentence + "\n", refusal.code)


def _body_refusal(headers: Headers, most: int) -> Refusal | None:
    """Return why the body of a request is refused; None if it is accepted."""
    kind = headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != "application/json":
        return Refusal(415, "Send JSON here: Content-Type: application/json.")
    length = headers.get("content-length", "")
    # The server enforces this length.
    if not length.isdecimal():
        return Refusal(411, "The length of the request is missing: Content-Length.")
    if int(length) > most:
        return Refusal(413, f"A request here has at most {most} bytes.")
    return None


def with_headers(send: Send, more: Mapping[str, str]) -> Send:
    """Add to every answer the headers that restrict browsers to what our pages need, and *more*."""
    added = _HEADERS | dict(more)

    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in added.items():
                headers[name] = value
        await send(message)

    return sent
