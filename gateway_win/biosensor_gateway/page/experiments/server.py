"""Listens for web experiments at the port of the settings, while these name any origin."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Callable, Collection
from typing import Any, NamedTuple

import structlog
import uvicorn
from fastapi import FastAPI, Request, WebSocket
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pylsl import local_clock
from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from biosensor_common.errors import ConfigError, GatewayError, TransportError, TransportReason
from biosensor_gateway.page.beside import ServerBeside
from biosensor_gateway.page.experiments.conversation import Conversation
from biosensor_gateway.page.experiments.models import NewMark, Sent
from biosensor_gateway.page.experiments.markers import Sending, WebMark
from biosensor_gateway.page.experiments.token import experiment_token, is_same
from biosensor_gateway.page.auth import Refusal, Sockets, body_refusal, with_headers
from biosensor_gateway.page.listening import listening_at
from biosensor_gateway.page.marker_models import ExperimentsView, ExperimentView
from biosensor_gateway.page.models import Problem
from biosensor_gateway.page.routes.errors import misformed
from biosensor_gateway.page.session import Session
from biosensor_gateway.settings.web_markers import WebMarkerSettings
from biosensor_gateway.streaming.markers import TimedBy, Timing

HOST = "127.0.0.1"
LOOK_S = 1.0
MAX_MESSAGE = 4096
MAX_CONNECTIONS = 50
_END_WITHIN_S = 1
_FOREIGN_SHOWN = 100

_log = structlog.get_logger("biosensor_gateway.page")
MARKERS = "/api/v1/markers"
SOCKET = "/api/v1/markers/socket"
MAX_BODY = 4096
MAX_SOCKETS = 16
_PREFLIGHT_HOLDS_S = 600
_BEARER = "bearer "


class _Wanted(NamedTuple):
    settings: WebMarkerSettings
    token: str


class ExperimentServer:
    """Serves web experiments on the loopback address, apart from the page's own server.

    What any page may try at a known port costs the page nothing: connections, messages and
    markers have limits of their own.

    Parameters
    ----------
    session
        Its settings say who may mark, also when they change; its `experiments` is kept up to date.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._sending = Sending(session.folder)
        self._foreign = ""

    async def run(self) -> None:
        """Listen as the settings want it, until cancelled."""
        while True:
            wanted = self._wanted()
            if wanted is None or not wanted.settings.origins:
                self._session.experiments = None
                await asyncio.sleep(LOOK_S)
                continue
            self._session.experiments = view = ExperimentsView(
                origins=list(wanted.settings.origins)
            )
            try:
                with listening_at(HOST, wanted.settings.port) as listening:
                    await self._serve(wanted, listening)
            except OSError as error:
                view.problem = _in_use(wanted.settings.port, error)
                await asyncio.sleep(LOOK_S)

    def _wanted(self) -> _Wanted | None:
        """Return what is to be listened for; None if nothing is, or nobody can tell."""
        try:
            settings = self._session.loaded().markers.web
            return _Wanted(settings, experiment_token(self._session.folder))
        except ConfigError as error:
            _log.debug("what web experiments may do is not known", problem=str(error))
            return None

    async def _serve(self, wanted: _Wanted, listening: socket.socket) -> None:
        """Serve until something else is wanted."""
        port = wanted.settings.port
        experiments = Experiments(wanted.token, self._sending)
        app = ExperimentGuard(
            experiments.app(), port, wanted.settings.origins, wanted.token, self._note_foreign
        )
        server = ServerBeside(
            uvicorn.Config(
                app,
                log_config=None,
                log_level=logging.WARNING,
                access_log=False,
                server_header=False,
                limit_concurrency=MAX_CONNECTIONS,
                ws_max_size=MAX_MESSAGE,
                ws_per_message_deflate=False,
                timeout_graceful_shutdown=_END_WITHIN_S,
                lifespan="off",
            )
        )
        serving = asyncio.create_task(server.serve([listening]))
        address = f"ws://{HOST}:{port}"
        _log.info("web experiments can mark", address=address, origins=wanted.settings.origins)
        try:
            while not serving.done() and (self._wanted() or wanted) == wanted:
                self._session.experiments = ExperimentsView(
                    address=address,
                    origins=list(wanted.settings.origins),
                    connected=experiments.connected,
                    foreign=self._foreign,
                )
                await asyncio.wait({serving}, timeout=LOOK_S)
        finally:
            server.should_exit = True
            await serving
            self._foreign = ""

    def _note_foreign(self, origin: str) -> None:
        self._foreign = origin[:_FOREIGN_SHOWN]


def _in_use(port: int, error: OSError) -> str:
    return (
        f"port {port} cannot be used ({error.strerror or error}): another page of this program or "
        "another program has it; close that, or set another port under [markers.web]"
    )


class Experiments:
    """The web experiments that are connected.

    Parameters
    ----------
    token
        What each has to know.
    sending
        Where markers go.
    """

    def __init__(self, token: str, sending: Sending) -> None:
        self._token = token
        self._sending = sending
        self._talking: set[Conversation] = set()

    @property
    def connected(self) -> list[ExperimentView]:
        """Which pages are there."""
        return [each.view for each in self._talking]

    def app(self) -> FastAPI:
        """Make the application; its guard has to stand before it."""
        app = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)
        app.post(MARKERS)(self._posted)
        app.websocket(SOCKET)(self._connected)
        app.exception_handler(GatewayError)(_refused)
        app.exception_handler(RequestValidationError)(misformed)
        return app

    async def _posted(self, mark: NewMark, request: Request) -> Sent:
        at, timing = local_clock(), Timing(TimedBy.ARRIVAL)
        if mark.age_ms is not None:
            at, timing = at - mark.age_ms / 1000, Timing(TimedBy.AGE)
        origin = request.headers["origin"]
        return await self._sending.send(WebMark(mark.marker, mark.note, origin, at, timing))

    async def _connected(self, socket: WebSocket) -> None:
        talk = Conversation(socket, socket.headers["origin"], self._token, self._sending)
        self._talking.add(talk)
        try:
            await talk.run()
        finally:
            self._talking.discard(talk)


async def _refused(_request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, GatewayError)
    code, headers = 400, dict[str, str]()
    if isinstance(error, TransportError):
        is_flood = error.reason is TransportReason.BUSY
        code, headers = (429 if is_flood else 503), {"Retry-After": "1"}
    return JSONResponse(Problem(problem=str(error)).model_dump(), code, headers)


class ExperimentGuard:
    """Checks every request and WebSocket of an experiment before the application sees it.

    Parameters
    ----------
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
