"""Sends the markers of web experiments to the agent: in order, each once, at a limited rate."""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from pydantic import BaseModel, Field, StringConstraints, TypeAdapter

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.agent import control
from biosensor_gateway.agent.marker_commands import MAX_TEXT, MAX_WEB_AGE_S
from biosensor_gateway.page.models import Body
from biosensor_gateway.streaming.marker_stream import MarkerKind, TimedBy, Timing

_Text = Annotated[str, StringConstraints(max_length=MAX_TEXT)]
_Milliseconds = Annotated[float, Field(allow_inf_nan=False, strict=False)]
_LARGEST = 2**53
_Number = Annotated[int, Field(ge=0, le=_LARGEST)]


class NewMark(Body):
    """A marker in a POST request.

    Attributes
    ----------
    age_ms
        Age of the marker in milliseconds; None if it happens now.
    """

    marker: _Text
    note: _Text = ""
    age_ms: Annotated[float, Field(ge=0, le=1000 * MAX_WEB_AGE_S, strict=False)] | None = None


class Hello(Body):
    """The first message of a page.

    Attributes
    ----------
    client
        Identifies the page, also after it has connected again.
    resolution_ms
        Resolution of the browser's clock in milliseconds.
    """

    type: Literal["hello"]
    token: Annotated[str, StringConstraints(max_length=200)]
    client: Annotated[str, StringConstraints(max_length=64)] = ""
    resolution_ms: Annotated[float, Field(ge=0, le=1000, strict=False)] = 1.0


class Pong(Body):
    """The answer to a ping: the browser's time in milliseconds."""

    type: Literal["pong"]
    n: _Number
    at: _Milliseconds


class Mark(Body):
    """A marker.

    Attributes
    ----------
    ref
        The page's number for the marker; the same if it is sent again.
    at
        The browser's time in milliseconds at which it happened; None for when it arrives.
    """

    type: Literal["mark"]
    ref: _Number
    marker: _Text
    note: _Text = ""
    at: _Milliseconds | None = None


class Sent(BaseModel):
    """A marker that the agent has sent.

    Attributes
    ----------
    id
        Its number in the stream.
    lsl_time
        When it happened, in seconds.
    timed_by, uncertainty_s
        How the time was determined, and its uncertainty in seconds; None if unknown.
    """

    id: int
    lsl_time: float
    timed_by: TimedBy
    uncertainty_s: float | None = None


MESSAGE: TypeAdapter[Pong | Mark] = TypeAdapter(Annotated[Pong | Mark, Field(discriminator="type")])

MARKS_PER_S, MARKS_AT_ONCE = 50, 100
_REMEMBERED = 2000


class Pace:
    """Limits a rate (token bucket): *per_s* per second on average, and *at_once* in a burst.

    Parameters
    ----------
    clock
        Seconds; for tests.
    """

    def __init__(
        self, per_s: float, at_once: int, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._per_s, self._most = per_s, at_once
        self._clock = clock
        self._left, self._then = float(at_once), clock()

    def allows(self) -> bool:
        """Count another marker if the limit permits it; return whether it does."""
        now = self._clock()
        self._left = min(self._most, self._left + (now - self._then) * self._per_s)
        self._then = now
        if self._left < 1:
            return False
        self._left -= 1
        return True


class WebMark(NamedTuple):
    """A marker with its time."""

    marker: str
    note: str
    origin: str  # Of the page.
    at: float  # LSL time in seconds.
    timing: Timing
    # Identifies the marker if it is sent again; None if it never is.
    key: tuple[str, int] | None = None


class Sending:
    """Sends markers to the agent of a state folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._pace = Pace(MARKS_PER_S, MARKS_AT_ONCE)
        self._one_at_a_time = asyncio.Lock()
        self._sent: OrderedDict[tuple[str, int] | None, Sent] = OrderedDict()

    async def send(self, mark: WebMark) -> Sent:
        """Send a marker to the agent, unless it was sent before; return the sent marker.

        Raises
        ------
        TransportError
            ``BUSY`` if there are too many; ``ABSENT`` or ``SILENT`` if no agent answers.
        ProtocolError
            ``REFUSED`` by the agent, with its sentence.
        """
        if mark.key not in self._sent and not self._pace.allows():
            message = f"more than {MARKS_PER_S} markers a second; send fewer, or later"
            raise TransportError(TransportReason.BUSY, message)
        # Shielded: a page that disconnects meanwhile will send the marker again, with its key.
        return await asyncio.shield(self._send(mark))

    async def _send(self, mark: WebMark) -> Sent:
        async with self._one_at_a_time:
            if mark.key is not None and mark.key in self._sent:
                return self._sent[mark.key]
            arguments = {
                "marker": mark.marker,
                "note": mark.note,
                "kind": MarkerKind.WEB.value,
                "source": mark.origin,
                "at": mark.at,
                **mark.timing._asdict(),
            }
            answer = await asyncio.to_thread(control.ask, self._folder, "mark", arguments)
            sent = Sent(id=answer["id"], lsl_time=answer["lsl_time"], **mark.timing._asdict())
            if mark.key is not None:
                self._sent[mark.key] = sent
                if len(self._sent) > _REMEMBERED:
                    self._sent.popitem(last=False)
            return sent
