"""Runs the server of the network's page, which serves nothing else."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncGenerator, Callable
from importlib.resources import as_file, files

from fastapi import FastAPI
from starlette.applications import Starlette
from starlette.routing import Router

from biosensor_gateway.page.front import PREFIX, Front
from biosensor_gateway.page.guard import DOOR, Keys
from biosensor_gateway.page.live import live
from biosensor_gateway.page.network.models import NetworkView
from biosensor_gateway.page.network.source import NetworkSource
from biosensor_gateway.page.server import HOST, guarded
from biosensor_gateway.page.steering import new_app

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
            front = Front(pages, _DOCUMENT, lambda app: self._serving(app, address))
            front.show(Router([live(self._source, self._source.status)]))
            front.complete(self._app())
            guarded(front, port, keys).run([listening])

    @contextlib.asynccontextmanager
    async def _serving(self, _app: Starlette, address: str) -> AsyncGenerator[None]:
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

    def _app(self) -> FastAPI:
        app = new_app()

        @app.get(f"{PREFIX}/streams")
        async def streams() -> NetworkView:  # pyright: ignore[reportUnusedFunction]
            """Say which streams this computer sees, and how they are."""
            return self._source.status()

        return app
