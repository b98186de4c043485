"""The page of the network: shows the LSL streams that this computer receives.

It listens before most of the program is loaded, as `agent_page` does. Only the settings are read
before a browser opens, so that their problems are reported in the terminal.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from biosensor_gateway.page.server import PageServer, cancelled, responsive
from biosensor_gateway.system.browser import WayIn

if TYPE_CHECKING:
    from starlette.types import ASGIApp

    from biosensor_gateway.page.network.source import NetworkSource
    from biosensor_gateway.settings.models import LslSettings


class NetworkPage:
    """Serves the page of the network.

    Parameters
    ----------
    settings
        A settings file, which need not exist; only its LSL section is used.
    on_ready
        Called in a thread, as soon as the page can be opened, with a way in.
    """

    def __init__(self, settings: Path, on_ready: Callable[[WayIn], None]) -> None:
        self._settings, self._on_ready = settings, on_ready
        self._server = PageServer("network.html", self._run)

    def run(self) -> None:
        """Serve until SIGINT or SIGTERM.

        Raises
        ------
        ConfigError
            If our settings or LSL's own settings are wrong.
        OSError
            If there is no free port on the loopback address.
        GatewayError
            An error of `on_ready`.
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
    """Return the API's application, which lists the streams that this computer sees."""
    with responsive():
        from biosensor_gateway.page.models import NetworkView
        from biosensor_gateway.page.routes.api import new_app
        from biosensor_gateway.page.static_files import PREFIX

        app = new_app()

        # Named here: annotations are looked up at the top of the module, which is light.
        @app.get(f"{PREFIX}/streams", response_model=NetworkView)
        async def streams() -> NetworkView:  # pyright: ignore[reportUnusedFunction]
            """List the streams that this computer sees, with their states."""
            return source.status()

        return app
