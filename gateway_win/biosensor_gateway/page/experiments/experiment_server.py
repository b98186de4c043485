"""Listens for web experiments at the port of the settings, if the settings name an origin."""

from __future__ import annotations

import asyncio
import json
import secrets
import socket
from pathlib import Path
from typing import Any, NamedTuple, cast

import structlog
from fastapi import FastAPI, Request, WebSocket
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pylsl import local_clock

from biosensor_common.errors import (
    ConfigError,
    ConfigReason,
    GatewayError,
    TransportError,
    TransportReason,
)
from biosensor_gateway.page.auth import MARKERS, ExperimentRules, Guard
from biosensor_gateway.page.experiments.conversation import Conversation
from biosensor_gateway.page.experiments.web_markers import NewMark, Sending, Sent, WebMark
from biosensor_gateway.page.models import ExperimentsView, ExperimentView, Problem
from biosensor_gateway.page.routes.api import misformed
from biosensor_gateway.page.server import EXPERIMENTS, HOST, listening_at, served_alongside
from biosensor_gateway.page.session import Session
from biosensor_gateway.settings.models import WebMarkerSettings
from biosensor_gateway.streaming.marker_stream import TimedBy, Timing
from biosensor_gateway.system import state_file

LOOK_S = 1.0
_FOREIGN_SHOWN = 100

_log = structlog.get_logger("biosensor_gateway.page")
SOCKET = "/api/v1/markers/socket"


class _Wanted(NamedTuple):
    settings: WebMarkerSettings
    token: str


class ExperimentServer:
    """Serves web experiments on the loopback address, separately from the page's server.

    Connections, messages and markers have separate limits, because any web page can send requests
    to this port.

    Parameters
    ----------
    session
        Has the settings, which may change; its `experiments` is kept up to date.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._sending = Sending(session.folder)
        self._foreign = ""

    async def run(self) -> None:
        """Listen as the settings say, until cancelled."""
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
        """Return the settings and the token; None if they cannot be read."""
        try:
            settings = self._session.loaded().markers.web
            return _Wanted(settings, experiment_token(self._session.folder))
        except ConfigError as error:
            _log.debug("it is not known whether web experiments can mark", problem=str(error))
            return None

    async def _serve(self, wanted: _Wanted, listening: socket.socket) -> None:
        """Serve until the settings change."""
        port = wanted.settings.port
        experiments = Experiments(wanted.token, self._sending)
        rules = ExperimentRules(port, wanted.settings.origins, wanted.token, self._note_foreign)
        app = Guard(experiments.app(), rules)
        address = f"ws://{HOST}:{port}"
        async with served_alongside(app, listening, EXPERIMENTS) as serving:
            _log.info("web experiments can mark", address=address, origins=wanted.settings.origins)
            while not serving.done() and (self._wanted() or wanted) == wanted:
                self._session.experiments = ExperimentsView(
                    address=address,
                    origins=list(wanted.settings.origins),
                    connected=experiments.connected,
                    foreign=self._foreign,
                )
                await asyncio.wait({serving}, timeout=LOOK_S)
        self._foreign = ""

    def _note_foreign(self, origin: str) -> None:
        self._foreign = origin[:_FOREIGN_SHOWN]


def _in_use(port: int, error: OSError) -> str:
    return (
        f"port {port} cannot be used ({error.strerror or error}): another page of this program or "
        "another program has it; close that, or set another port under [markers.web]"
    )


class Experiments:
    """The application for web experiments, with its open connections."""

    def __init__(self, token: str, sending: Sending) -> None:
        self._token = token
        self._sending = sending
        self._talking: set[Conversation] = set()

    @property
    def connected(self) -> list[ExperimentView]:
        """Views of the connected pages."""
        return [each.view for each in self._talking]

    def app(self) -> FastAPI:
        """Return the application, which needs a `Guard` in front."""
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


KEPT_IN = "web-markers.json"
_BYTES = 24


def experiment_token(folder: Path) -> str:
    """Return the token in the state folder, where only its user can read it, or create one.

    Raises
    ------
    ConfigError
        ``UNREADABLE`` if it can neither be read nor written.
    """
    try:
        written: Any = json.loads(state_file.read(folder / KEPT_IN))
    except FileNotFoundError:
        return new_experiment_token(folder)
    except OSError as error:
        raise _unreadable(folder, error) from error
    except (ValueError, RecursionError):
        written = None
    token = cast("dict[str, Any]", written).get("token") if isinstance(written, dict) else None
    return token if isinstance(token, str) and token else new_experiment_token(folder)


def new_experiment_token(folder: Path) -> str:
    """Replace the token by a new one.

    Raises
    ------
    ConfigError
        ``UNREADABLE`` if it cannot be written.
    """
    token = secrets.token_urlsafe(_BYTES)
    try:
        text = json.dumps({"token": token})
        state_file.replace(folder / KEPT_IN, text, private=True, durable=True)
    except OSError as error:
        raise _unreadable(folder, error) from error
    return token


def _unreadable(folder: Path, error: OSError) -> ConfigError:
    message = f"{folder / KEPT_IN}: {error.strerror or error}; web experiments cannot mark"
    return ConfigError(ConfigReason.UNREADABLE, message)
