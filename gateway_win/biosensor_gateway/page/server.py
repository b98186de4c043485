"""Runs the server: on the loopback address, at a port that the system chooses."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import mimetypes
import signal
import socket
import sys
from collections.abc import AsyncGenerator, Callable, Coroutine, Generator, Mapping, Sequence
from importlib.resources import as_file, files
from pathlib import Path
from types import FrameType
from typing import Any

import uvicorn
from fastapi import FastAPI
from fastapi.staticfiles import StaticFiles

from biosensor_common.errors import GatewayError
from biosensor_gateway.page.api import PREFIX, add_api
from biosensor_gateway.page.ending import Ending
from biosensor_gateway.page.experiments.server import ExperimentServer
from biosensor_gateway.page.guard import DOOR, OPENS_ONCE, Guard, Keys
from biosensor_gateway.page.link import AgentLink
from biosensor_gateway.page.live import add_live
from biosensor_gateway.page.marking import Marking
from biosensor_gateway.page.models import ShareView
from biosensor_gateway.page.quitting import add_quit
from biosensor_gateway.page.recorder import Recorder
from biosensor_gateway.page.running import ADDRESS, IS_SHARED, SETTINGS, only_server, reachable
from biosensor_gateway.page.session import Session

HOST = "127.0.0.1"
MAX_CONNECTIONS = 100
MAX_MESSAGE = 64 * 1024
"""Bytes of a message from a browser."""
_OPTIONS: Mapping[str, Any] = {
    "log_config": None,
    "log_level": logging.WARNING,
    "access_log": False,
    "server_header": False,
    "limit_concurrency": MAX_CONNECTIONS,
    "ws_max_size": MAX_MESSAGE,
    "timeout_graceful_shutdown": 2,
}
_Serve = Callable[[], Coroutine[Any, Any, None]]
_REQUESTS = [signal.SIGINT, signal.SIGBREAK if sys.platform == "win32" else signal.SIGTERM]


class PageServer:
    """Serves the page until it is told to end.

    Parameters
    ----------
    folder
        The state folder of the agent; other programs of its user find the server there.
    settings
        The settings file.
    on_ready
        Called in a thread with an address that opens the page once, as soon as it can be
        opened. A `GatewayError` that it raises ends the server.
    end_after_s
        How long there must have been neither window nor agent nor recording for the server to
        end by itself.
    share_port
        TCP port where other computers look on, 0 for any that is free; None for no other.
    """

    def __init__(
        self,
        folder: Path,
        settings: Path,
        on_ready: Callable[[str], None],
        end_after_s: float = math.inf,
        share_port: int | None = None,
    ) -> None:
        self._folder = folder
        self._session = Session(folder, settings)
        self._recorder = Recorder(self._session)
        self._marking = Marking(self._session)
        self._ending = Ending(self._session, end_after_s)
        self._on_ready = on_ready
        self._share_port = share_port

    @property
    def share(self) -> ShareView | None:
        """How other computers look on, once the server runs."""
        return self._session.share

    def run(self) -> None:
        """Serve until SIGINT or SIGTERM, or until somebody ends the page.

        Raises
        ------
        ConfigError
            ``IN_USE`` if the state folder has a server already.
        OSError
            There is no port on the loopback address.
        TransportError
            Other computers were to look on, and cannot.
        GatewayError
            Whatever `on_ready` has raised.
        """
        with (
            only_server(self._folder),
            socket.create_server((HOST, 0)) as listening,
            as_file(files("biosensor_gateway.page") / "static") as pages,
            self._shared(pages) as beside,
        ):
            port: int = listening.getsockname()[1]
            keys = Keys(port)
            app = self._app(pages, keys, port, beside)
            self._server = guarded(app, port, keys)
            self._server.run([listening])
        if self._ending.error is not None:
            raise self._ending.error

    @contextlib.contextmanager
    def _shared(self, pages: Path) -> Generator[Sequence[_Serve]]:
        """Open the way for other computers to look on, if that is wanted; what serves it."""
        if self._share_port is None:
            yield ()
            return
        # Its certificate takes a fifth of the time of a start.
        from biosensor_gateway.page.sharing import Sharing  # noqa: PLC0415

        with Sharing(self._session, pages, _OPTIONS).opened(self._share_port) as serve:
            yield (serve,)

    def _end(self) -> None:
        self._server.should_exit = True

    @contextlib.asynccontextmanager
    async def _serving(
        self, keys: Keys, port: int, beside: Sequence[_Serve]
    ) -> AsyncGenerator[None]:
        """Run what goes on beside the requests."""
        session = self._session
        link = AgentLink(
            self._folder, session.take_status, session.traces.take, session.take_dropped
        )

        def way_in() -> str:
            return f"http://{HOST}:{port}{DOOR}?token={keys.new_token()}"

        async def new_window(_arguments: Mapping[str, Any]) -> dict[str, Any]:
            return {
                ADDRESS: way_in(),
                SETTINGS: str(session.settings),
                IS_SHARED: self.share is not None,
            }

        async def end(_arguments: Mapping[str, Any]) -> dict[str, Any]:
            self._ending.request()
            return {}

        async with reachable(self._folder, new_window, end):
            running = [
                asyncio.create_task(each)
                for each in (
                    link.run(),
                    self._recorder.run(),
                    self._marking.run(),
                    ExperimentServer(session).run(),
                    self._ending.run(self._end),
                    self._show(way_in()),
                    *(serve() for serve in beside),
                )
            ]
            try:
                yield
            finally:
                for task in running:
                    task.cancel()
                await asyncio.gather(*running, return_exceptions=True)

    async def _show(self, address: str) -> None:
        try:
            await asyncio.to_thread(self._on_ready, address)
        except GatewayError as error:
            self._ending.request(error)

    def _app(self, pages: Path, keys: Keys, port: int, beside: Sequence[_Serve]) -> FastAPI:
        app = new_app(lambda _app: self._serving(keys, port, beside))
        add_api(app, self._session, self._recorder, self._marking)
        add_quit(app, self._session, self._recorder, self._ending)
        add_live(app, self._session, self._session.status)
        app.mount("/", StaticFiles(directory=pages, html=True))
        return app


def new_app(lifespan: Callable[[FastAPI], contextlib.AbstractAsyncContextManager[None]]) -> FastAPI:
    """Return an application without pages that load scripts of other servers."""
    # Windows asks its registry, where any program may have said otherwise.
    mimetypes.add_type("text/javascript", ".js")
    return FastAPI(
        title="Biosensor Gateway",
        version="1",
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        openapi_url=f"{PREFIX}/openapi.json",
    )


def guarded(app: FastAPI, port: int, keys: Keys) -> uvicorn.Server:
    """Return the server of an application for the browser of this computer; signals end it."""
    origins = [f"http://{name}:{port}" for name in (HOST, "localhost")]
    config = uvicorn.Config(Guard(app, origins, keys, OPENS_ONCE), lifespan="on", **_OPTIONS)
    # When it has ended by a signal, uvicorn raises that signal again.
    for number in _REQUESTS:
        signal.signal(number, _ignore)
    return uvicorn.Server(config)


def _ignore(_number: int, _frame: FrameType | None) -> None:
    pass
