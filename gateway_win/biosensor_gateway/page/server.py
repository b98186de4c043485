"""Runs the servers: the page for the browser of this computer, and others in the same process."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import shutil
import signal
import socket
import sys
from collections.abc import AsyncGenerator, Awaitable, Callable, Generator, Iterable
from importlib.resources import as_file, files
from pathlib import Path
from types import FrameType
from typing import Literal, NamedTuple

import uvicorn
from starlette.applications import Starlette
from starlette.types import ASGIApp

from biosensor_common.process_limits import END_S, end_within
from biosensor_gateway.page.auth import DOOR, OPENS_ONCE, BrowserRules, Guard, Keys
from biosensor_gateway.page.static_files import Front
from biosensor_gateway.system.browser import WayIn, way_in

HOST = "127.0.0.1"
ENDS_WITHIN_S = END_S
"""Limit for the whole end: windows are notified, and a replay has its own limit."""
_SWITCH_S = 0.0005
_SIGNALS = [signal.SIGINT, signal.SIGBREAK if sys.platform == "win32" else signal.SIGTERM]


class Role(NamedTuple):
    """Limits of a server, by its kind of clients."""

    max_connections: int
    max_message: int  # Bytes of a message from a browser.
    ends_within_s: int  # Limit for requests that are being answered when the server ends.
    compresses: bool = True


PEOPLE = Role(max_connections=100, max_message=64 * 1024, ends_within_s=2)
EXPERIMENTS = Role(max_connections=50, max_message=4096, ends_within_s=1, compresses=False)


def _config(
    app: ASGIApp, role: Role, lifespan: Literal["on", "off"], certificate: Path | None = None
) -> uvicorn.Config:
    return uvicorn.Config(
        app,
        log_config=None,
        log_level=logging.WARNING,
        access_log=False,
        server_header=False,
        limit_concurrency=role.max_connections,
        ws_max_size=role.max_message,
        ws_per_message_deflate=role.compresses,
        timeout_graceful_shutdown=role.ends_within_s,
        lifespan=lifespan,
        ssl_certfile=certificate,
    )


class PageServer:
    """Serves a page to the browser of this computer.

    It listens before most of the program is loaded, so that a browser has something to show.

    Parameters
    ----------
    run
        Loads the other parts and runs them; when it returns, the server ends.
    """

    front: Front
    pages: Path

    def __init__(self, document: str, run: Callable[[], Awaitable[None]]) -> None:
        self._document, self._run = document, run
        self._running: asyncio.Task[None] | None = None
        self._redirects: dict[str, str] = {}

    def serve(self) -> None:
        """Serve until SIGINT, SIGTERM, SIGHUP or the end of `run`, whose error is raised.

        Raises
        ------
        OSError
            If there is no free port on the loopback address.
        """
        with (
            listening_at(HOST, 0) as listening,
            as_file(files("biosensor_gateway.page") / "static") as self.pages,
        ):
            self._port: int = listening.getsockname()[1]
            self._keys = Keys(self._port, self._remove_redirect)
            self.front = Front(self.pages, self._document, self._serving)
            origins = [f"http://{name}:{self._port}" for name in (HOST, "localhost")]
            guard = Guard(self.front, BrowserRules(origins, self._keys, OPENS_ONCE))
            # Ignored here, because uvicorn raises a signal again after it has ended by it.
            for number in _SIGNALS:
                signal.signal(number, _ignore)
            self._server = _Server(_config(guard, PEOPLE, "on"))
            # Not one of uvicorn's signals. Under nohup it stays ignored.
            if sys.platform != "win32" and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
                signal.signal(signal.SIGHUP, self._server.handle_exit)
            try:
                self._server.run([listening])
            finally:
                for token in [*self._redirects]:
                    self._remove_redirect(token)
        task = self._running
        if task is not None and task.done() and not task.cancelled():
            task.result()

    def way_in(self) -> WayIn:
        """Return an address that opens the page once."""
        token = self._keys.new_token()
        way = way_in(f"http://{HOST}:{self._port}{DOOR}?token={token}")
        self._redirects[token] = way.redirect
        return way

    def _remove_redirect(self, token: str) -> None:
        if redirect := self._redirects.pop(token, ""):
            shutil.rmtree(Path(redirect).parent, ignore_errors=True)

    def end(self) -> None:
        """End soon, after the requests that are being answered."""
        self._server.should_exit = True

    @contextlib.asynccontextmanager
    async def _serving(self, _app: Starlette) -> AsyncGenerator[None]:
        self._running = asyncio.create_task(self._run_and_end())
        try:
            yield
        finally:
            await cancelled([self._running])

    async def _run_and_end(self) -> None:
        try:
            await self._run()
        finally:
            self.end()


class _Server(uvicorn.Server):
    """Ends within a limit, even if its threads are blocked."""

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Note the signal; see uvicorn."""
        if not self.should_exit:
            end_within(ENDS_WITHIN_S)
        super().handle_exit(sig, frame)


class _ServerAlongside(uvicorn.Server):
    """Leaves the signals to the server of the page."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None]:
        """Capture no signals."""
        yield


@contextlib.asynccontextmanager
async def served_alongside(
    app: ASGIApp, listening: socket.socket, role: Role, certificate: Path | None = None
) -> AsyncGenerator[asyncio.Task[None]]:
    """Serve an application in the process of the page while the context lasts.

    Parameters
    ----------
    certificate
        Certificate and key as PEM, to serve over TLS.
    """
    server = _ServerAlongside(_config(app, role, "off", certificate))
    serving = asyncio.create_task(server.serve([listening]))
    try:
        yield serving
    finally:
        server.should_exit = True
        await serving


def listening_at(host: str, port: int) -> socket.socket:
    """Open a listening TCP socket with TCP_NODELAY; port 0 for any free port.

    Raises
    ------
    OSError
        If the port is taken, or there is none.
    """
    listening = socket.create_server((host, port))
    # asyncio sets TCP_NODELAY only if the socket has a protocol number, which those of
    # `create_server` lack. Without it, the second part of each answer waits 40 ms for a delayed
    # acknowledgement (RFC 896 and RFC 1122, 4.2.3.2). Accepted connections inherit the option.
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listening


@contextlib.contextmanager
def responsive() -> Generator[None]:
    """Switch threads ten times as often, so that importing does not block the server."""
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


def _ignore(_number: int, _frame: FrameType | None) -> None:
    pass
