"""Listens for web experiments at the port of the settings, while these name any origin."""

from __future__ import annotations

import asyncio
import logging
import socket
from typing import NamedTuple

import structlog
import uvicorn

from biosensor_common.errors import ConfigError
from biosensor_gateway.page.beside import ServerBeside
from biosensor_gateway.page.experiments.app import Experiments
from biosensor_gateway.page.experiments.guard import ExperimentGuard
from biosensor_gateway.page.experiments.sending import Sending
from biosensor_gateway.page.experiments.token import experiment_token
from biosensor_gateway.page.listening import listening_at
from biosensor_gateway.page.marker_models import ExperimentsView
from biosensor_gateway.page.session import Session
from biosensor_gateway.settings.web_markers import WebMarkerSettings

HOST = "127.0.0.1"
LOOK_S = 1.0
MAX_MESSAGE = 4096
MAX_CONNECTIONS = 50
_END_WITHIN_S = 1
_FOREIGN_SHOWN = 100

_log = structlog.get_logger("biosensor_gateway.page")


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
