"""Runs the server of the network's page, which serves nothing else."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncGenerator, Callable
from importlib.resources import as_file, files
from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import FileResponse
from fastapi.staticfiles import StaticFiles

from biosensor_gateway.page.api import PREFIX
from biosensor_gateway.page.guard import DOOR, Keys
from biosensor_gateway.page.live import add_live
from biosensor_gateway.page.network.models import NetworkView
from biosensor_gateway.page.network.source import NetworkSource
from biosensor_gateway.page.server import HOST, guarded, new_app

_DOCUMENT = "network.html"


class NetworkServer:
    """Serves the page until it is told to end.

    Parameters
    ----------
    source
    on_ready
        Called in a thread with an address that opens the page once, as soon as it can be
        opened.
    """

    def __init__(self, source: NetworkSource, on_ready: Callable[[str], None]) -> None:
        self._source = source
        self._on_ready = on_ready

    def run(self) -> None:
        """Serve until SIGINT or SIGTERM.

        Raises
        ------
        OSError
            There is no port on the loopback address.
        """
        with (
            socket.create_server((HOST, 0)) as listening,
            as_file(files("biosensor_gateway.page") / "static") as pages,
        ):
            port: int = listening.getsockname()[1]
            keys = Keys(port)
            address = f"http://{HOST}:{port}{DOOR}?token={keys.new_token()}"
            guarded(self._app(pages, address), port, keys).run([listening])

    @contextlib.asynccontextmanager
    async def _serving(self, address: str) -> AsyncGenerator[None]:
        running = [
            asyncio.create_task(self._source.run()),
            asyncio.create_task(asyncio.to_thread(self._on_ready, address)),
        ]
        try:
            yield
        finally:
            for task in running:
                task.cancel()
            await asyncio.gather(*running, return_exceptions=True)

    def _app(self, pages: Path, address: str) -> FastAPI:
        app = new_app(lambda _app: self._serving(address))

        @app.get(f"{PREFIX}/streams")
        async def streams() -> NetworkView:  # pyright: ignore[reportUnusedFunction]
            """Say which streams this computer sees, and how they are."""
            return self._source.status()

        @app.get("/", include_in_schema=False)
        async def page() -> FileResponse:  # pyright: ignore[reportUnusedFunction]
            return FileResponse(pages / _DOCUMENT)

        add_live(app, self._source, self._source.status)
        app.mount("/", StaticFiles(directory=pages))
        return app
