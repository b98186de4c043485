"""Runs the server of the network's page, which serves nothing else.

It listens before most of the program is loaded, as `biosensor_gateway.page.server` does; only what
is wrong in the settings file is found before a browser opens.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Callable
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING

from starlette.applications import Starlette

from biosensor_gateway.page.static_files import Front
from biosensor_gateway.page.auth import DOOR, Keys
from biosensor_gateway.page.listening import listening_at
from biosensor_gateway.page.server import HOST, cancelled, guarded, raise_error_of, responsive

if TYPE_CHECKING:
    from starlette.types import ASGIApp

    from biosensor_gateway.page.network_page.source import NetworkSource

_DOCUMENT = "network.html"


class NetworkServer:
    """Serves the page until it is told to end.

    Parameters
    ----------
    settings
        A settings file, of which the LSL section counts; it need not exist.
    on_ready
        Called in a thread with an address that opens the page once, as soon as it can be
        opened.
    """

    def __init__(self, settings: Path, on_ready: Callable[[str], None]) -> None:
        self._settings, self._on_ready = settings, on_ready
        self._running: asyncio.Task[None] | None = None

    def run(self) -> None:
        """Serve until SIGINT or SIGTERM.

        Raises
        ------
        ConfigError
            The settings are wrong, or LSL's own are.
        OSError
            There is no port on the loopback address.
        GatewayError
            Whatever `on_ready` has raised.
        """
        with (
            listening_at(HOST, 0) as listening,
            as_file(files("biosensor_gateway.page") / "static") as pages,
        ):
            port: int = listening.getsockname()[1]
            keys = Keys(port)
            self._address = f"http://{HOST}:{port}{DOOR}?token={keys.new_token()}"
            self._front = Front(pages, _DOCUMENT, self._serving)
            self._server = guarded(self._front, port, keys)
            self._server.run([listening])
        raise_error_of(self._running)

    @contextlib.asynccontextmanager
    async def _serving(self, _app: Starlette) -> AsyncGenerator[None]:
        self._running = asyncio.create_task(self._run())
        try:
            yield
        finally:
            await cancelled([self._running])

    async def _run(self) -> None:
        """Load the rest and run it until cancelled; an error ends the server."""
        running: list[asyncio.Task[None]] = []
        try:
            await asyncio.to_thread(self._check_settings)
            shown = asyncio.create_task(asyncio.to_thread(self._on_ready, self._address))
            running.append(shown)
            source = await asyncio.to_thread(self._source)
            self._front.show(_live(source))
            running.append(asyncio.create_task(source.run()))
            self._front.complete(await asyncio.to_thread(_api, source))
            await asyncio.gather(*running)
        finally:
            await cancelled(running)
            self._server.should_exit = True

    def _check_settings(self) -> None:
        from biosensor_gateway.page.network_page.lsl_settings import lsl_settings

        lsl_settings(self._settings)

    def _source(self) -> NetworkSource:
        with responsive():
            from biosensor_gateway.page.network_page.source import NetworkSource

            return NetworkSource(self._settings)


def _live(source: NetworkSource) -> ASGIApp:
    from starlette.routing import Router

    from biosensor_gateway.page.live import live

    return Router([live(source, source.status)])


def _api(source: NetworkSource) -> ASGIApp:
    with responsive():
        from biosensor_gateway.page.network_page.api import network_api

        return network_api(source)
