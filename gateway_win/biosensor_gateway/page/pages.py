"""The pages of the agent and of the network: they listen at once, and load the rest later.

This module imports only what a server needs to listen. A thread loads the rest while the browser
opens: first the live view, then the API. The page of the network shows the LSL streams that this
computer receives; only its settings are read before, so that the terminal reports their problems.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncGenerator, Callable, Coroutine, Mapping
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from biosensor_common.errors import ConfigError, GatewayError
from biosensor_common.process_limits import end_within
from biosensor_gateway.page.instance import (
    ADDRESS,
    IS_SHARED,
    REDIRECT,
    SETTINGS,
    only_server,
    reachable,
)
from biosensor_gateway.page.server import ENDS_WITHIN_S, PageServer, cancelled, responsive
from biosensor_gateway.system.browser import WayIn

if TYPE_CHECKING:
    from starlette.types import ASGIApp

    from biosensor_gateway.page.agent_client import AgentLink
    from biosensor_gateway.page.interface import Interface
    from biosensor_gateway.page.models import ShareView
    from biosensor_gateway.page.network.network_thread import NetworkSource
    from biosensor_gateway.page.session import Session, Shutdown
    from biosensor_gateway.settings.models import LslSettings

_FIRST_S = 1.5


class AgentPage:
    """Serves the page of the agent.

    Parameters
    ----------
    folder
        The agent's state folder, where other programs of the same user find the server.
    on_ready
        Called in a thread, as soon as the page can be opened, with a way in.
        An error that it raises ends the server.
    open_log
        Called in another thread once the page has something to show.
    end_after_s
        The server ends after this time in seconds without a window, an agent and a recording.
    share_port
        TCP port of the view for other computers, 0 for any free port; None to share nothing.
    """

    def __init__(
        self,
        folder: Path,
        settings: Path,
        on_ready: Callable[[WayIn], None],
        open_log: Callable[[], None],
        end_after_s: float = math.inf,
        share_port: int | None = None,
    ) -> None:
        self._folder, self._settings = folder, settings
        self._on_ready, self._open_log = on_ready, open_log
        self._end_after_s, self._share_port = end_after_s, share_port
        self._server = PageServer("index.html", self._run)
        self._unfound: ConfigError | None = None
        self._unopened: GatewayError | None = None
        self.share: ShareView | None = None

    def run(self) -> None:
        """Serve until SIGINT or SIGTERM, or until the page is ended on request.

        Raises
        ------
        ConfigError
            ``IN_USE`` if the state folder has a server already.
        OSError
            If there is no free port on the loopback address.
        TransportError
            If the view for other computers cannot be served.
        GatewayError
            An error of `on_ready`.
        """
        with only_server(self._folder) as self._unfound:
            self._server.serve()
        if self._unopened is not None:
            raise self._unopened

    async def _run(self) -> None:
        """Load all parts and run them until the page is ended, or one of them fails."""
        running: list[asyncio.Task[None]] = []

        def begin(alongside: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
            running.append(asyncio.create_task(alongside))
            return running[-1]

        try:
            if self._share_port is None:
                begin(self._show())
            session, shutdown, link, live = await asyncio.to_thread(self._load)
            self._server.front.show(live)
            ended = begin(shutdown.run())
            begin(link.run())
            # The API takes twice as long to load. The first status comes before it, because a
            # person looks at the page before clicking.
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_FIRST_S):
                    await session.told.wait()
            interface = await asyncio.to_thread(self._load_more, session, shutdown)
            self._server.front.complete(interface.app)
            begin(interface.run())
            async with self._shared(session), self._reachable(shutdown):
                if self._share_port is not None:
                    begin(self._show())
                await ended
                # With exit code 0, because it has been asked to end, or is not needed any more.
                end_within(ENDS_WITHIN_S, code=0)
        finally:
            await cancelled(running)

    def _load(self) -> tuple[Session, Shutdown, AgentLink, ASGIApp]:
        with responsive():
            from biosensor_gateway.page.agent_client import AgentLink
            from biosensor_gateway.page.live_feed import live
            from biosensor_gateway.page.session import Session, Shutdown

            session = Session(self._folder, self._settings)
            link = AgentLink(
                self._folder, session.take_status, session.traces.take, session.take_dropped
            )
            shutdown = Shutdown(session, self._end_after_s)
            return session, shutdown, link, live(session, session.status)

    def _load_more(self, session: Session, shutdown: Shutdown) -> Interface:
        self._open_log()
        with responsive():
            from biosensor_gateway.page.interface import Interface

            return Interface(session, shutdown)

    async def _show(self) -> None:
        try:
            await asyncio.to_thread(self._on_ready, self._server.way_in())
        except GatewayError as error:
            self._unopened = error
            self._server.end()

    @contextlib.asynccontextmanager
    async def _shared(self, session: Session) -> AsyncGenerator[None]:
        """Serve the view for other computers, if it is switched on."""
        if self._share_port is None:
            yield
            return
        # Imported late: the certificate's library takes a fifth of the time of a start.
        from biosensor_gateway.page.share import shared

        async with shared(session, self._server.pages, self._share_port) as self.share:
            yield

    def _reachable(self, shutdown: Shutdown) -> AbstractAsyncContextManager[None]:
        """Accept requests of the same user's programs for a window, or for the end."""

        async def new_window(_arguments: Mapping[str, Any]) -> dict[str, Any]:
            way = self._server.way_in()
            return {
                ADDRESS: way.address,
                REDIRECT: way.redirect,
                SETTINGS: str(self._settings),
                IS_SHARED: self.share is not None,
            }

        async def end(_arguments: Mapping[str, Any]) -> dict[str, Any]:
            shutdown.request()
            return {}

        return reachable(self._folder, new_window, end, self._unfound)


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
            front.complete(await asyncio.to_thread(network_interface, source))
            await asyncio.gather(*running)
        finally:
            await cancelled(running)

    def _lsl(self) -> LslSettings:
        from biosensor_gateway.devices.registry import settings_models
        from biosensor_gateway.settings.file import load_or_defaults

        return load_or_defaults(self._settings, settings_models()).lsl

    def _source(self, lsl: LslSettings) -> tuple[NetworkSource, ASGIApp]:
        with responsive():
            from biosensor_gateway.page.live_feed import live
            from biosensor_gateway.page.network.network_thread import NetworkSource

            source = NetworkSource(lsl, self._settings)
            return source, live(source, source.status)


def network_interface(source: NetworkSource) -> ASGIApp:
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
