"""Runs the server: on the loopback address, at a port that the system chooses."""

from __future__ import annotations

import asyncio
import contextlib
import json
import mimetypes
import os
import signal
import socket
import sys
from collections.abc import AsyncGenerator, Callable
from importlib.resources import as_file, files
from pathlib import Path
from types import FrameType

import uvicorn
from fastapi import FastAPI
from fastapi.staticfiles import StaticFiles

from biosensor_gateway.page.api import PREFIX, add_api
from biosensor_gateway.page.guard import DOOR, Guard, Keys
from biosensor_gateway.page.link import AgentLink
from biosensor_gateway.page.live import add_live
from biosensor_gateway.page.marking import Marking
from biosensor_gateway.page.recorder import Recorder
from biosensor_gateway.page.session import Session
from biosensor_gateway.system import state_file

HOST = "127.0.0.1"
PAGE_FILE = "page.json"
MAX_CONNECTIONS = 100
MAX_MESSAGE = 64 * 1024
"""Bytes of a message from a browser."""
_END_WITHIN_S = 2
_REQUESTS = [signal.SIGINT, signal.SIGBREAK if sys.platform == "win32" else signal.SIGTERM]


class PageServer:
    """Serves the page until it is told to end.

    Parameters
    ----------
    folder
        The state folder of the agent; says there where the page is, for its user alone.
    settings
        The settings file.
    on_ready
        Called with an address that opens the page once, as soon as it can be opened.
    """

    def __init__(self, folder: Path, settings: Path, on_ready: Callable[[str], None]) -> None:
        self._folder = folder
        self._session = Session(folder, settings)
        self._recorder = Recorder(self._session)
        self._marking = Marking(self._session)
        self._on_ready = on_ready

    def run(self) -> None:
        """Serve until SIGINT or SIGTERM.

        Raises
        ------
        OSError
            There is no port on the loopback address.
        """
        with socket.create_server((HOST, 0)) as listening:
            port: int = listening.getsockname()[1]
            keys = Keys(port)
            with as_file(files("biosensor_gateway.page") / "static") as pages:
                app = self._app(pages, keys, port)
                config = uvicorn.Config(
                    Guard(app, port, keys),
                    log_config=None,
                    access_log=False,
                    server_header=False,
                    limit_concurrency=MAX_CONNECTIONS,
                    ws_max_size=MAX_MESSAGE,
                    timeout_graceful_shutdown=_END_WITHIN_S,
                    lifespan="on",
                )
                # When it has ended by a signal, uvicorn raises that signal again.
                for number in _REQUESTS:
                    signal.signal(number, _ignore)
                uvicorn.Server(config).run([listening])

    def _app(self, pages: Path, keys: Keys, port: int) -> FastAPI:
        @contextlib.asynccontextmanager
        async def lifespan(_app: FastAPI) -> AsyncGenerator[None]:
            session = self._session
            link = AgentLink(
                self._folder, session.take_status, session.take_samples, session.take_dropped
            )
            running = [
                asyncio.create_task(each.run()) for each in (link, self._recorder, self._marking)
            ]
            address = f"http://{HOST}:{port}"
            entry = json.dumps({"address": address, "process": os.getpid()})
            with contextlib.suppress(OSError):
                state_file.replace(self._folder / PAGE_FILE, entry, private=True)
            self._on_ready(f"{address}{DOOR}?token={keys.new_token()}")
            try:
                yield
            finally:
                for task in running:
                    task.cancel()
                await asyncio.gather(*running, return_exceptions=True)
                with contextlib.suppress(OSError):
                    (self._folder / PAGE_FILE).unlink()

        app = FastAPI(
            title="Biosensor Gateway",
            version="1",
            lifespan=lifespan,
            # Their pages load scripts of other servers.
            docs_url=None,
            redoc_url=None,
            openapi_url=f"{PREFIX}/openapi.json",
        )
        # Windows asks its registry, where any program may have said otherwise.
        mimetypes.add_type("text/javascript", ".js")
        add_api(app, self._session, self._recorder, self._marking)
        add_live(app, self._session, self._session.status)
        app.mount("/", StaticFiles(directory=pages, html=True))
        return app


def _ignore(_number: int, _frame: FrameType | None) -> None:
    pass
