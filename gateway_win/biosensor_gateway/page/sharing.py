"""Lets other computers look on: over TLS, with a token of its own, and nothing can be changed."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable, Coroutine, Generator, Mapping, Sequence
from functools import partial
from pathlib import Path, PurePath
from typing import Any

import uvicorn
from fastapi import FastAPI
from fastapi.responses import FileResponse
from fastapi.staticfiles import StaticFiles

from biosensor_common.doctor.checks.interfaces import interfaces
from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.page.beside import ServerBeside
from biosensor_gateway.page.certificate import Certificate, own_certificate
from biosensor_gateway.page.guard import DOOR, Guard, ViewKeys
from biosensor_gateway.page.listening import listening_at
from biosensor_gateway.page.live import live
from biosensor_gateway.page.models import ShareView, StatusView
from biosensor_gateway.page.session import Session

EVERYWHERE = "0.0.0.0"  # noqa: S104 - asked for, and nothing can be changed there
_REFUSED = (
    "The address to look on here is shown on the page of the computer that the sensors are "
    "connected to. It is another one each time the page is started there."
)


class Sharing:
    """Serves the page once more, for other computers.

    Parameters
    ----------
    session
        What is shown; its `share` says where.
    pages
        The folder of the page's files.
    options
        Of the server, as for the page itself.
    """

    def __init__(self, session: Session, pages: Path, options: Mapping[str, Any]) -> None:
        self._session = session
        self._pages = pages
        self._options = options

    @contextlib.contextmanager
    def opened(self, port: int) -> Generator[Callable[[], Coroutine[Any, Any, None]]]:
        """Open a TCP port on every network of this computer; 0 for any that is free.

        Yields what serves until it is cancelled.

        Raises
        ------
        TransportError
            ``BUSY`` if the port is taken; ``ABSENT`` if there is no network, or the
            certificate cannot be kept.
        """
        with _listening(port) as listening:
            number: int = listening.getsockname()[1]
            addresses = _addresses()
            names = [*addresses, socket.gethostname().lower()]
            certificate = _certificate(self._session.folder, names)
            keys = ViewKeys(number)
            self._session.share = ShareView(
                addresses=[
                    f"https://{each}:{number}{DOOR}?token={keys.token}" for each in addresses
                ],
                fingerprint=certificate.fingerprint,
            )
            guard = Guard(
                self._app(), [f"https://{name}:{number}" for name in names], keys, _REFUSED
            )
            config = uvicorn.Config(
                guard, ssl_certfile=certificate.file, lifespan="off", **self._options
            )
            yield partial(_serve, ServerBeside(config), listening)

    def _app(self) -> FastAPI:
        app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)

        @app.get("/api/v1/status")
        async def status() -> StatusView:
            """Say how the agent and its devices are."""
            return self._status()

        @app.get("/")
        async def page() -> FileResponse:
            return FileResponse(self._pages / "view.html")

        app.router.routes.append(live(self._session, self._status))
        app.mount("/", StaticFiles(directory=self._pages))
        return app

    def _status(self) -> StatusView:
        """Describe everything but where this computer keeps its files."""
        status = self._session.status()
        recording = status.recording
        verdict = recording.verdict
        if verdict is not None:
            verdict = verdict.model_copy(update={"file": PurePath(verdict.file).name})
        shown = recording.model_copy(
            update={"folder": "", "file": PurePath(recording.file).name, "verdict": verdict}
        )
        return status.model_copy(
            update={
                "share": None,
                "experiments": None,
                "settings_file": "",
                "problem": "The settings file has a mistake." if status.problem else "",
                "recording": shown,
                "replay": status.replay.model_copy(update={"said": []}),
            }
        )


async def _serve(server: uvicorn.Server, listening: socket.socket) -> None:
    serving = asyncio.create_task(server.serve([listening]))
    try:
        await asyncio.shield(serving)
    finally:
        server.should_exit = True
        await serving


@contextlib.contextmanager
def _listening(port: int) -> Generator[socket.socket]:
    try:
        listening = listening_at(EVERYWHERE, port)
    except OSError as error:
        message = (
            f"other computers cannot look on: TCP {port} cannot be opened "
            f"({error.strerror or error}); choose another with --share-port"
        )
        raise TransportError(TransportReason.BUSY, message) from error
    with listening:
        yield listening


def _certificate(folder: Path, names: Sequence[str]) -> Certificate:
    try:
        return own_certificate(folder, names)
    except OSError as error:
        message = (
            f"other computers cannot look on: the certificate cannot be kept in {folder} "
            f"({error.strerror or error})"
        )
        raise TransportError(TransportReason.ABSENT, message) from error


def _addresses() -> Sequence[str]:
    """Return the IPv4 addresses by which other computers reach this one."""
    found = [each for each in interfaces() if not each.is_loopback]
    addresses = [address for each in found for address in each.addresses]
    if not addresses:
        message = "other computers cannot look on: this computer is in no network"
        raise TransportError(TransportReason.ABSENT, message)
    return addresses
