"""Lets in nobody but the browser that the program itself has opened.

Any web page that a person visits can send requests to this computer, and any program on it can,
too. So a request must name this server by its own address (else a foreign name that was pointed
to it would make the server a part of that foreign page), come from this server's own page, and
have the cookie that only the program gives away.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Iterable, Mapping
from http.cookies import CookieError, SimpleCookie
from typing import Literal, NamedTuple

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

DOOR = "/door"
MAX_BODY = 64 * 1024
MAX_SOCKETS = 32
"""Browser windows at a time."""
OPENS_ONCE = (
    "This address opens once. Open the page again from the program: biosensor-gateway page, or "
    "the entry of the Start menu."
)
_TOKENS_KEPT = 16
REFUSED_SOCKET = 1008
"""The code with which a WebSocket is closed that is not wanted."""

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
    """Why a request is not carried out: a code of HTTP, and a sentence for people."""

    code: int
    sentence: str


class Keys:
    """Opens the page: tokens that are good once, and the cookie that they are changed for.

    Parameters
    ----------
    port
        Browsers send a cookie to every port of a computer, so it is in the cookie's name.

    Attributes
    ----------
    same_site
        What a browser is told of the cookie: whether it goes along with a link of another page.
    """

    same_site: Literal["lax", "strict"] = "strict"

    def __init__(self, port: int) -> None:
        self.cookie_name = f"biosensor_gateway_{port}"
        self._cookie = secrets.token_urlsafe(32)
        self._tokens: list[str] = []

    def new_token(self) -> str:
        """Make a token that opens the page once."""
        token = secrets.token_urlsafe(32)
        self._tokens = [*self._tokens, token][-_TOKENS_KEPT:]
        return token

    def cookie_for(self, token: str) -> str | None:
        """Take a token, and return the cookie; None for one that is wrong or used."""
        for known in self._tokens:
            if hmac.compare_digest(known.encode(), token.encode(errors="replace")):
                self._tokens.remove(known)
                return self._cookie
        return None

    def fits(self, cookie: str) -> bool:
        """Whether a cookie is the right one."""
        return hmac.compare_digest(cookie.encode(errors="replace"), self._cookie.encode())


class ViewKeys(Keys):
    """Opens the view for other computers: its token is good until the server ends.

    Nothing can be changed there, so a link on another page, as in a mail, may lead to it.
    """

    same_site = "lax"

    def __init__(self, port: int) -> None:
        super().__init__(port)
        self.token = secrets.token_urlsafe(16)

    def cookie_for(self, token: str) -> str | None:
        """Return the cookie; None for a token that is wrong."""
        fits = hmac.compare_digest(token.encode(errors="replace"), self.token.encode())
        return self._cookie if fits else None


class Sockets:
    """Passes WebSockets on, so many at a time.

    Parameters
    ----------
    most
        How many.
    """

    def __init__(self, app: ASGIApp, most: int) -> None:
        self._app = app
        self._most = most
        self._open = 0

    async def serve(self, scope: Scope, receive: Receive, send: Send, *, is_refused: bool) -> None:
        """Pass one on, unless it is refused or there are as many already."""
        if is_refused or self._open >= self._most:
            await receive()
            await send({"type": "websocket.close", "code": REFUSED_SOCKET})
            return
        self._open += 1
        try:
            await self._app(scope, receive, send)
        finally:
            self._open -= 1


class Guard:
    """Checks every request and WebSocket before the application sees it.

    Parameters
    ----------
    origins
        Addresses of the server, such as ``http://127.0.0.1:1234``; it is asked by no other.
    refused
        What is said to whoever comes without the cookie.
    """

    def __init__(self, app: ASGIApp, origins: Iterable[str], keys: Keys, refused: str) -> None:
        self._app = app
        self._keys = keys
        self._refused = refused
        self._origins = frozenset(origins)
        self._hosts = {each.partition("://")[2] for each in self._origins}
        self._is_secure = all(each.startswith("https:") for each in self._origins)
        self._sockets = Sockets(app, MAX_SOCKETS)

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
        refusal = self._foreign(headers, needs_origin=True) or self._stranger(headers)
        await self._sockets.serve(scope, receive, send, is_refused=refusal is not None)

    async def _request(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = Headers(scope=scope)
        changes = scope["method"] not in {"GET", "HEAD"}
        refusal = self._foreign(headers, needs_origin=changes)
        if refusal is None and scope["path"] == DOOR:
            await self._door(Request(scope))(scope, receive, with_headers(send))
            return
        refusal = refusal or self._stranger(headers) or (body_refusal(headers) if changes else None)
        if refusal is not None:
            response = PlainTextResponse(refusal.sentence + "\n", refusal.code)
            await response(scope, receive, with_headers(send))
            return
        await self._app(scope, receive, with_headers(send))

    def _door(self, request: Request) -> Response:
        cookie = self._keys.cookie_for(request.query_params.get("token", ""))
        if cookie is None:
            return PlainTextResponse(self._refused + "\n", 403)
        response = RedirectResponse("/", 303)
        response.set_cookie(
            self._keys.cookie_name,
            cookie,
            path="/",
            secure=self._is_secure,
            httponly=True,
            samesite=self._keys.same_site,
        )
        return response

    def _foreign(self, headers: Headers, *, needs_origin: bool) -> Refusal | None:
        if headers.get("host", "") not in self._hosts:
            return Refusal(421, "This server is asked by a name that is not its own.")
        origin = headers.get("origin")
        if origin not in self._origins and (needs_origin or origin is not None):
            return Refusal(403, "Another web page has sent this; only the program's own may.")
        is_link = self._keys.same_site == "lax" and headers.get("sec-fetch-mode") == "navigate"
        if not is_link and headers.get("sec-fetch-site", "none") not in {"same-origin", "none"}:
            return Refusal(403, "Another web page has sent this; only the program's own may.")
        return None

    def _stranger(self, headers: Headers) -> Refusal | None:
        try:
            cookies = SimpleCookie(headers.get("cookie", ""))
        except CookieError:
            cookies = SimpleCookie()
        cookie = cookies.get(self._keys.cookie_name)
        if cookie is None or not self._keys.fits(cookie.value):
            return Refusal(401, self._refused)
        return None


def body_refusal(headers: Headers, most: int = MAX_BODY) -> Refusal | None:
    """Return why what comes with a request is not read; None if it is.

    Parameters
    ----------
    headers
        Of the request.
    most
        How many bytes it may have.
    """
    kind = headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != "application/json":
        return Refusal(415, "What is sent here is JSON: Content-Type: application/json.")
    length = headers.get("content-length", "")
    # The server holds a client to it.
    if not length.isdecimal():
        return Refusal(411, "The length of what is sent must be said: Content-Length.")
    if int(length) > most:
        return Refusal(413, f"What is sent here has at most {most} bytes.")
    return None


def with_headers(send: Send, more: Mapping[str, str] | None = None) -> Send:
    """Add to every answer what forbids a browser whatever no page of ours needs.

    Parameters
    ----------
    more
        Other headers to add.
    """
    added = _HEADERS | dict(more or {})

    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in added.items():
                headers[name] = value
        await send(message)

    return sent
