"""Lets in pages of the named origins alone, and only to send markers.

Another web page cannot pretend to be of one of them, for it is the browser that says so; another
program can, and so there is the token, too. A foreign name for this computer is refused as by
the page's own guard.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from biosensor_gateway.page.experiments.token import is_same
from biosensor_gateway.page.guard import Refusal, Sockets, body_refusal, with_headers

MARKERS = "/api/v1/markers"
SOCKET = "/api/v1/markers/socket"
MAX_BODY = 4096
MAX_SOCKETS = 16
_PREFLIGHT_HOLDS_S = 600
_BEARER = "bearer "


class ExperimentGuard:
    """Checks every request and WebSocket of an experiment before the application sees it.

    Parameters
    ----------
    app
    port
        On which the server listens, on the loopback address alone.
    origins
        Those that may send markers.
    token
        What a request has to have; a WebSocket says it later, for a browser lets no script
        choose the headers of one.
    on_foreign
        Is told the origin of a page that was refused.
    """

    def __init__(
        self,
        app: ASGIApp,
        port: int,
        origins: Collection[str],
        token: str,
        on_foreign: Callable[[str], None],
    ) -> None:
        self._app = app
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        self._origins = frozenset(origins)
        self._token = token
        self._on_foreign = on_foreign
        self._sockets = Sockets(app, MAX_SOCKETS)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it with a sentence."""
        if scope["type"] == "websocket":
            await self._socket(scope, receive, send)
        else:
            await self._request(scope, receive, send)

    async def _socket(self, scope: Scope, receive: Receive, send: Send) -> None:
        refusal = self._foreign(Headers(scope=scope))
        await self._sockets.serve(scope, receive, send, is_refused=refusal is not None)

    async def _request(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = Headers(scope=scope)
        foreign = self._foreign(headers)
        if foreign is not None:
            # Without a word of CORS: the browser keeps the answer from the page.
            await _answer(foreign)(scope, receive, with_headers(send))
            return
        # What is refused is for the page to read, too.
        shown = with_headers(send, _named(headers["origin"]))
        is_preflight = scope["method"] == "OPTIONS" and scope["path"] == MARKERS
        if is_preflight:
            await _preflight(headers)(scope, receive, shown)
            return
        refusal = self._stranger(headers) or (
            body_refusal(headers, MAX_BODY) if scope["method"] == "POST" else None
        )
        if refusal is None:
            await self._app(scope, receive, shown)
        else:
            await _answer(refusal)(scope, receive, shown)

    def _foreign(self, headers: Headers) -> Refusal | None:
        if headers.get("host", "") not in self._hosts:
            return Refusal(421, "This server is asked by a name that is not its own.")
        origin = headers.get("origin")
        if origin in self._origins:
            return None
        if origin is None:
            return Refusal(403, "Markers come from web pages here, whose browser names an Origin.")
        self._on_foreign(origin)
        return Refusal(403, "This origin is not among the origins under [markers.web].")

    def _stranger(self, headers: Headers) -> Refusal | None:
        given = headers.get("authorization", "")
        if given[: len(_BEARER)].lower() == _BEARER:
            token = given[len(_BEARER) :].strip()
            if is_same(token, self._token):
                return None
        return Refusal(401, "The token is wrong; biosensor-gateway mark --web shows the right one.")


def _answer(refusal: Refusal) -> Response:
    return PlainTextResponse(refusal.sentence + "\n", refusal.code)


def _named(origin: str) -> dict[str, str]:
    # Never '*', and no word of credentials: cookies have no part in this.
    return {"Access-Control-Allow-Origin": origin, "Vary": "Origin"}


def _preflight(headers: Headers) -> Response:
    allowed: dict[str, Any] = {
        "Access-Control-Allow-Methods": "POST",
        "Access-Control-Allow-Headers": "Authorization, Content-Type",
        "Access-Control-Max-Age": str(_PREFLIGHT_HOLDS_S),
    }
    # Asked by browsers before a public page may reach this computer.
    if headers.get("access-control-request-private-network") == "true":
        allowed["Access-Control-Allow-Private-Network"] = "true"
    return Response(status_code=204, headers=allowed)
