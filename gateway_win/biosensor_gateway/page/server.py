"""Runs the server: on the loopback address, at a port that the system chooses.

It listens before most of the program is loaded. Only what that takes is imported here; the rest is
in `service` and `steering`, which are loaded in a thread while the browser opens.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import signal
import sys
from collections.abc import AsyncGenerator, Callable, Coroutine, Generator, Iterable, Mapping
from contextlib import AbstractAsyncContextManager
from importlib.resources import as_file, files
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import uvicorn
from starlette.applications import Starlette
from starlette.types import ASGIApp

from biosensor_common.ending import end_within
from biosensor_common.errors import GatewayError
from biosensor_gateway.page.static_files import Front
from biosensor_gateway.page.auth import DOOR, OPENS_ONCE, Guard, Keys
from biosensor_gateway.page.listening import listening_at
from biosensor_gateway.page.instance import ADDRESS, IS_SHARED, SETTINGS, only_server

if TYPE_CHECKING:
    from biosensor_gateway.page.models import ShareView
    from biosensor_gateway.page.service import Service
    from biosensor_gateway.page.session import Session
    from biosensor_gateway.page.steering import Steering

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
_ENDS_WITHIN_S = 10.0
"""Windows hear of the end, and a replay has its own time to end."""
_SWITCH_S = 0.0005
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
        opened. An error that it raises ends the server.
    open_log
        Called in another thread once the page has something to show.
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
        open_log: Callable[[], None],
        end_after_s: float = math.inf,
        share_port: int | None = None,
    ) -> None:
        self._folder, self._settings = folder, settings
        self._on_ready, self._open_log = on_ready, open_log
        self._end_after_s, self._share_port = end_after_s, share_port
        self._running: asyncio.Task[None] | None = None
        self._unopened: GatewayError | None = None
        self.share: ShareView | None = None

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
            only_server(self._folder) as self._unfound,
            listening_at(HOST, 0) as listening,
            as_file(files("biosensor_gateway.page") / "static") as self._pages,
        ):
            self._port: int = listening.getsockname()[1]
            self._keys = Keys(self._port)
            self._front = Front(self._pages, "index.html", self._serving)
            self._server = guarded(self._front, self._port, self._keys)
            self._server.run([listening])
        if self._unopened is not None:
            raise self._unopened
        raise_error_of(self._running)

    def _way_in(self) -> str:
        return f"http://{HOST}:{self._port}{DOOR}?token={self._keys.new_token()}"

    @contextlib.asynccontextmanager
    async def _serving(self, _app: Starlette) -> AsyncGenerator[None]:
        """Run what goes on beside the requests."""
        self._running = asyncio.create_task(self._run())
        try:
            yield
        finally:
            await cancelled([self._running])

    async def _run(self) -> None:
        """Load the rest and run it until somebody ends the page; an error ends it, too."""
        running: list[asyncio.Task[None]] = []

        def begin(beside: Coroutine[Any, Any, None]) -> None:
            running.append(asyncio.create_task(beside))

        try:
            if self._share_port is None:
                begin(self._show())
            service = await asyncio.to_thread(self._load)
            ended = asyncio.create_task(service.shutdown.run())
            running.append(ended)
            self._front.show(service.live)
            begin(service.run())
            # What follows needs the processor twice as long, and a person looks before a click.
            await service.shown()
            steering = await asyncio.to_thread(self._load_more, service)
            self._front.complete(steering.app)
            begin(steering.run())
            async with self._shared(service.session), self._reachable(service):
                if self._share_port is not None:
                    begin(self._show())
                await ended
        finally:
            await cancelled(running)
            self._server.should_exit = True

    def _load(self) -> Service:
        with responsive():
            from biosensor_gateway.page.service import Service

            return Service(self._folder, self._settings, self._end_after_s)

    def _load_more(self, service: Service) -> Steering:
        self._open_log()
        with responsive():
            from biosensor_gateway.page.steering import Steering

            return Steering(service)

    async def _show(self) -> None:
        try:
            await asyncio.to_thread(self._on_ready, self._way_in())
        except GatewayError as error:
            self._unopened = error
            self._server.should_exit = True

    @contextlib.asynccontextmanager
    async def _shared(self, session: Session) -> AsyncGenerator[None]:
        """Let other computers look on, if that is wanted."""
        if self._share_port is None:
            yield
            return
        # Its certificate takes a fifth of the time of a start.
        from biosensor_gateway.page.sharing import Sharing

        with Sharing(session, self._pages, _OPTIONS).opened(self._share_port) as serve:
            self.share = session.share
            serving = asyncio.create_task(serve())
            try:
                yield
            finally:
                await cancelled([serving])

    def _reachable(self, service: Service) -> AbstractAsyncContextManager[None]:
        """Let other programs of the same user ask for a window, or for the end."""
        from biosensor_gateway.page.reachable import reachable

        async def new_window(_arguments: Mapping[str, Any]) -> dict[str, Any]:
            return {
                ADDRESS: self._way_in(),
                SETTINGS: str(self._settings),
                IS_SHARED: self.share is not None,
            }

        async def end(_arguments: Mapping[str, Any]) -> dict[str, Any]:
            service.shutdown.request()
            return {}

        return reachable(self._folder, new_window, end, self._unfound)


def guarded(app: ASGIApp, port: int, keys: Keys) -> uvicorn.Server:
    """Return the server of an application for the browser of this computer; signals end it."""
    origins = [f"http://{name}:{port}" for name in (HOST, "localhost")]
    config = uvicorn.Config(Guard(app, origins, keys, OPENS_ONCE), lifespan="on", **_OPTIONS)
    # When it has ended by a signal, uvicorn raises that signal again.
    for number in _REQUESTS:
        signal.signal(number, _ignore)
    return _Server(config)


class _Server(uvicorn.Server):
    """Ends in time, whatever its threads wait for."""

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Note the signal; see uvicorn."""
        if not self.should_exit:
            end_within(_ENDS_WITHIN_S)
        super().handle_exit(sig, frame)


@contextlib.contextmanager
def responsive() -> Generator[None]:
    """Have a thread that loads give way to the one that serves, ten times as often as usual."""
    usual_s = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_S)
    try:
        yield
    finally:
        sys.setswitchinterval(usual_s)


async def cancelled(tasks: Iterable[asyncio.Task[None]]) -> None:
    """Cancel tasks and wait for their end."""
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


def raise_error_of(task: asyncio.Task[None] | None) -> None:
    """Raise what a task has ended with, unless it ended well, was cancelled or never began."""
    if task is not None and task.done() and not task.cancelled():
        task.result()


def _ignore(_number: int, _frame: FrameType | None) -> None:
    pass
