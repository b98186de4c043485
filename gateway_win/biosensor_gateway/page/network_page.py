"""The page of the network: shows which LSL streams arrive here, and changes nothing.

It listens before most of the program is loaded, as `agent_page` does; only what is wrong in the
settings file is found before a browser opens.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from biosensor_gateway.page.server import PageServer, cancelled, responsive

if TYPE_CHECKING:
    from starlette.types import ASGIApp

    from biosensor_gateway.page.network.source import NetworkSource
    from biosensor_gateway.settings.models import LslSettings


class NetworkPage:
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
        self._server = PageServer("network.html", self._run)

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
        self._server.serve()

    async def _run(self) -> None:
        """Load the rest and run it until cancelled; an error ends the server."""
        running: list[asyncio.Task[None]] = []
        front = self._server.front
        try:
            lsl = await asyncio.to_thread(self._lsl)
            shown = asyncio.to_thread(self._on_ready, self._server.way_in())
            running.append(asyncio.create_task(shown))
            source, live = await asyncio.to_thread(self._source, lsl)
            front.show(live)
            running.append(asyncio.create_task(source.run()))
            front.complete(await asyncio.to_thread(interface, source))
            await asyncio.gather(*running)
        finally:
            await cancelled(running)

    def _lsl(self) -> LslSettings:
        from biosensor_gateway.devices.registry import settings_models
        from biosensor_gateway.settings.file import load_or_defaults

        return load_or_defaults(self._settings, settings_models()).lsl

    def _source(self, lsl: LslSettings) -> tuple[NetworkSource, ASGIApp]:
        with responsive():
            from biosensor_gateway.page.live import live
            from biosensor_gateway.page.network.source import NetworkSource

            source = NetworkSource(lsl, self._settings)
            return source, live(source, source.status)


def interface(source: NetworkSource) -> ASGIApp:
    """Return what can be asked for: the streams that this computer sees."""
    with responsive():
        from biosensor_gateway.page.models import NetworkView
        from biosensor_gateway.page.routes.api import new_app
        from biosensor_gateway.page.static_files import PREFIX

        app = new_app()

        # Named here: annotations are looked up at the top of the module, which is light.
        @app.get(f"{PREFIX}/streams", response_model=NetworkView)
        async def streams() -> NetworkView:  # pyright: ignore[reportUnusedFunction]
            """Say which streams this computer sees, and how they are."""
            return source.status()

        return app
