"""Serves the page's files at once, and the other applications as soon as they are loaded.

The libraries of the API take a while to import. A browser that opens meanwhile gets the page and
its scripts, and their requests wait here.
"""

from __future__ import annotations

import asyncio
import mimetypes
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from pathlib import Path

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

PREFIX = "/api/v1"
LIVE = "/live"
"""The WebSocket."""

Lifespan = Callable[[Starlette], AbstractAsyncContextManager[None]]


class Front:
    """The application of a server whose API and WebSocket are loaded later."""

    def __init__(self, pages: Path, document: str, lifespan: Lifespan | None = None) -> None:
        # On Windows the type comes from the registry, which any program may have changed.
        mimetypes.add_type("text/javascript", ".js")
        routes = [_file("/", pages / document)]
        routes += [
            _file(f"/{each.relative_to(pages).as_posix()}", each)
            for each in pages.rglob("*")
            if each.is_file()
        ]
        self._files = Starlette(routes=routes, lifespan=lifespan)
        self._live, self._rest = _Later(), _Later()

    def show(self, live: ASGIApp) -> None:
        """Set the application of the WebSocket."""
        self._live.take(live)

    def complete(self, rest: ASGIApp) -> None:
        """Set the application of the API."""
        self._rest.take(rest)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer with a file, or pass the request to an application once it is loaded."""
        await self._app(scope)(scope, receive, send)

    def _app(self, scope: Scope) -> ASGIApp:
        if scope["type"] == "lifespan":
            return self._files
        if scope["type"] == "websocket":
            return self._live
        return self._rest if scope["path"].startswith(f"{PREFIX}/") else self._files


def _file(path: str, file: Path) -> Route:
    """Return the route of a file, which is served from memory."""
    # Not read in a thread, which would wait several times per file for the thread that imports.
    content, kind = file.read_bytes(), mimetypes.guess_type(file.name)[0]

    async def answer(_request: Request) -> Response:
        return Response(content, media_type=kind)

    return Route(path, answer)


class _Later:
    """Passes requests to an application; they wait until it is loaded."""

    def __init__(self) -> None:
        self._app: ASGIApp | None = None
        self._is_here = asyncio.Event()

    def take(self, app: ASGIApp) -> None:
        self._app = app
        self._is_here.set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        await self._is_here.wait()
        assert self._app is not None
        await self._app(scope, receive, send)
