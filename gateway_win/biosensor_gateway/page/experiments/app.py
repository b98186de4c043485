"""The interface for web experiments: `POST /api/v1/markers` and a WebSocket beside it."""

from __future__ import annotations

from fastapi import FastAPI, Request, WebSocket
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pylsl import local_clock

from biosensor_common.errors import GatewayError, TransportError, TransportReason
from biosensor_gateway.page.experiments.conversation import Conversation
from biosensor_gateway.page.experiments.guard import MARKERS, SOCKET
from biosensor_gateway.page.experiments.models import NewMark, Sent
from biosensor_gateway.page.experiments.sending import Sending, WebMark
from biosensor_gateway.page.marker_models import ExperimentView
from biosensor_gateway.page.models import Problem
from biosensor_gateway.page.refusals import misformed
from biosensor_gateway.streaming.markers import TimedBy, Timing


class Experiments:
    """The web experiments that are connected.

    Parameters
    ----------
    token
        What each has to know.
    sending
        Where markers go.
    """

    def __init__(self, token: str, sending: Sending) -> None:
        self._token = token
        self._sending = sending
        self._talking: set[Conversation] = set()

    @property
    def connected(self) -> list[ExperimentView]:
        """Which pages are there."""
        return [each.view for each in self._talking]

    def app(self) -> FastAPI:
        """Make the application; its guard has to stand before it."""
        app = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)
        app.post(MARKERS)(self._posted)
        app.websocket(SOCKET)(self._connected)
        app.exception_handler(GatewayError)(_refused)
        app.exception_handler(RequestValidationError)(misformed)
        return app

    async def _posted(self, mark: NewMark, request: Request) -> Sent:
        at, timing = local_clock(), Timing(TimedBy.ARRIVAL)
        if mark.age_ms is not None:
            at, timing = at - mark.age_ms / 1000, Timing(TimedBy.AGE)
        origin = request.headers["origin"]
        return await self._sending.send(WebMark(mark.marker, mark.note, origin, at, timing))

    async def _connected(self, socket: WebSocket) -> None:
        talk = Conversation(socket, socket.headers["origin"], self._token, self._sending)
        self._talking.add(talk)
        try:
            await talk.run()
        finally:
            self._talking.discard(talk)


async def _refused(_request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, GatewayError)
    code, headers = 400, dict[str, str]()
    if isinstance(error, TransportError):
        is_flood = error.reason is TransportReason.BUSY
        code, headers = (429 if is_flood else 503), {"Retry-After": "1"}
    return JSONResponse(Problem(problem=str(error)).model_dump(), code, headers)
