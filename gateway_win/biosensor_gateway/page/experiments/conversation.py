"""Serves one page of a web experiment: measures its clock, and receives its markers."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import deque
from collections.abc import Coroutine
from typing import Any, NamedTuple

from fastapi import WebSocket, WebSocketDisconnect
from pydantic import ValidationError
from pylsl import local_clock

from biosensor_common.errors import GatewayError, TransportError
from biosensor_gateway.agent.marker_commands import MAX_LEAD_S, MAX_WEB_AGE_S
from biosensor_gateway.page.auth import REFUSED_SOCKET, is_same
from biosensor_gateway.page.experiments.web_markers import (
    MESSAGE,
    Hello,
    Mark,
    Pace,
    Pong,
    Sending,
    Sent,
    WebMark,
)
from biosensor_gateway.page.models import ExperimentView
from biosensor_gateway.streaming.marker_stream import TimedBy, Timing

HELLO_WITHIN_S = 5.0
PINGS_FIRST, FIRST_EVERY_S = 8, 0.03
PING_EVERY_S, UNTIL_KNOWN_EVERY_S = 2.0, 0.25
MESSAGES_PER_S, MESSAGES_AT_ONCE = 200, 400
MARKS_WAITING = 64
_PINGS_OPEN = 16
CLOCK_DRIFT = 1e-4
"""Largest relative drift between a browser's clock and LSL's."""
EXCHANGES_KEPT = 32
EXCHANGES_NEEDED = 5
"""Number of exchanges before the clock counts as known."""
COARSEST_CLOCK_S = 0.2
"""Limit of a clock's resolution; browsers that resist fingerprinting have steps of 0.1 s."""


class Conversation:
    """The messages of one WebSocket."""

    def __init__(self, socket: WebSocket, origin: str, token: str, sending: Sending) -> None:
        self._socket = socket
        self._origin = origin
        self._token = token
        self._sending = sending
        self._client = ""
        self._clock = BrowserClock(0.0)
        self._time = MarkedTime(self._clock)
        self._asked: dict[int, float] = {}
        self._marks: asyncio.Queue[tuple[Mark, float]] = asyncio.Queue(MARKS_WAITING)
        self._is_set_again = asyncio.Event()
        self._pace = Pace(MESSAGES_PER_S, MESSAGES_AT_ONCE)

    @property
    def view(self) -> ExperimentView:
        """Origin of the page, and the uncertainty of its clock."""
        return ExperimentView(origin=self._origin, uncertainty_s=self._clock.newest_uncertainty_s)

    async def run(self) -> None:
        """Exchange messages until the page disconnects, or sends an invalid message."""
        await self._socket.accept()
        problem = await self._hello()
        if not problem:
            tasks = [
                asyncio.create_task(_quietly(each)) for each in (self._measure(), self._mark())
            ]
            try:
                problem = await self._receive()
            finally:
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)
        with contextlib.suppress(RuntimeError, WebSocketDisconnect):
            await self._socket.close(REFUSED_SOCKET, problem)

    async def _hello(self) -> str:
        """Return the problem of the first message; empty if there is none."""
        try:
            async with asyncio.timeout(HELLO_WITHIN_S):
                hello = Hello.model_validate_json(await self._socket.receive_text())
        except (ValidationError, KeyError, TimeoutError):
            return "the first message must be hello, with the token"
        except WebSocketDisconnect:
            return "gone"
        if not is_same(hello.token, self._token):
            return "the token is wrong; biosensor-gateway mark --web shows the right one"
        self._client = hello.client
        self._clock = BrowserClock(hello.resolution_ms / 1000)
        self._time = MarkedTime(self._clock)
        return ""

    async def _receive(self) -> str:
        """Receive messages until the end; return its reason."""
        try:
            while True:
                text = await self._socket.receive_text()
                arrival = local_clock()
                if not self._pace.allows():
                    return f"more than {MESSAGES_PER_S} messages a second"
                message = MESSAGE.validate_json(text)
                if isinstance(message, Pong):
                    self._note(message, arrival)
                else:
                    await self._take(message, arrival)
        except (ValidationError, KeyError):
            return "a message is neither a pong nor a mark as documented"
        except WebSocketDisconnect:
            return "gone"

    def _note(self, pong: Pong, arrival: float) -> None:
        asked = self._asked.pop(pong.n, None)
        if asked is not None and not self._clock.note(Exchange(asked, pong.at / 1000, arrival)):
            self._is_set_again.set()

    async def _take(self, mark: Mark, arrival: float) -> None:
        try:
            self._marks.put_nowait((mark, arrival))
        except asyncio.QueueFull:
            await self._refuse(mark, "too many markers are already waiting", again=True)

    async def _measure(self) -> None:
        """Ask for the browser's time: several times at first, then every two seconds."""
        number, is_known = 0, False
        while True:
            self._is_set_again.clear()
            for _ in range(PINGS_FIRST):
                number += 1
                await self._ping(number)
                await asyncio.sleep(FIRST_EVERY_S)
            while not self._is_set_again.is_set():
                if self._clock.is_known and not is_known:
                    is_known = True
                    await self._say(type="ready", uncertainty_s=self._clock.newest_uncertainty_s)
                with contextlib.suppress(TimeoutError):
                    pause_s = PING_EVERY_S if self._clock.is_known else UNTIL_KNOWN_EVERY_S
                    async with asyncio.timeout(pause_s):
                        await self._is_set_again.wait()
                number += 1
                await self._ping(number)

    async def _ping(self, number: int) -> None:
        if len(self._asked) >= _PINGS_OPEN:
            # A busy page answers all pings at once, and the newest has the shortest round trip.
            del self._asked[next(iter(self._asked))]
        self._asked[number] = local_clock()
        await self._say(type="ping", n=number)

    async def _mark(self) -> None:
        while True:
            mark, arrival = await self._marks.get()
            try:
                sent = await self._sent(mark, arrival)
            except RefusedTimeError as refused:
                if refused.is_clock:
                    self._is_set_again.set()
                await self._refuse(mark, str(refused), again=refused.is_clock)
            except TransportError as error:
                await self._refuse(mark, str(error), again=True)
            except GatewayError as error:
                await self._refuse(mark, str(error), again=False)
            else:
                await self._say(type="marked", ref=mark.ref, **sent.model_dump())

    async def _sent(self, mark: Mark, arrival: float) -> Sent:
        at, timing = self._time.of(mark, arrival)
        key = (self._client, mark.ref) if self._client else None
        return await self._sending.send(
            WebMark(mark.marker, mark.note, self._origin, at, timing, key)
        )

    async def _refuse(self, mark: Mark, problem: str, *, again: bool) -> None:
        await self._say(type="refused", ref=mark.ref, problem=problem, again=again)

    async def _say(self, **message: object) -> None:
        await self._socket.send_json(message)


async def _quietly(talking: Coroutine[Any, Any, None]) -> None:
    """Send until the page disconnects; the receiving task reports that."""
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        await talking


class RefusedTimeError(Exception):
    """The time of a marker is impossible; the message is the sentence for the page."""

    def __init__(self, sentence: str, *, is_clock: bool = False) -> None:
        super().__init__(sentence)
        # Whether the time may be possible after the browser's clock is measured again.
        self.is_clock = is_clock


class MarkedTime:
    """Converts the times of one page's markers to LSL times."""

    def __init__(self, clock: BrowserClock) -> None:
        self._clock = clock
        self._doubted: int | None = None

    def of(self, mark: Mark, arrival: float) -> tuple[float, Timing]:
        """Return the LSL time of a marker in seconds, and how it was determined.

        Parameters
        ----------
        arrival
            LSL time in seconds at which the marker was received.

        Raises
        ------
        RefusedTimeError
            If the clock is not known yet, or the time is too far from the arrival.
        """
        if mark.at is None:
            return arrival, Timing(TimedBy.ARRIVAL)
        if not self._clock.is_known:
            message = "the page's clock is not measured yet; it must answer each ping with a pong"
            raise RefusedTimeError(message, is_clock=True)
        known = self._clock.to_lsl(mark.at / 1000)
        ahead_s = known.lsl_time - arrival
        if ahead_s > MAX_LEAD_S + known.uncertainty_s:
            raise self._of_the_future(mark.ref, ahead_s)
        if ahead_s < -MAX_WEB_AGE_S:
            message = f"it happened {-ahead_s:.0f} s ago, and the limit is {MAX_WEB_AGE_S:.0f} s"
            raise RefusedTimeError(message)
        self._doubted = None
        at = min(known.lsl_time, arrival + MAX_LEAD_S)
        # Rounded up to the digits of the answer.
        return at, Timing(TimedBy.CLOCK, math.ceil(1e6 * known.uncertainty_s) / 1e6)

    def _of_the_future(self, ref: int, ahead_s: float) -> RefusedTimeError:
        # Either the page is wrong, or its clock was set. After another measurement of the clock,
        # the page is wrong.
        is_clock, self._doubted = self._doubted != ref, ref
        if is_clock:
            self._clock.reset()
        return RefusedTimeError(
            f"it would happen {ahead_s:.3f} s after its arrival, and the limit is {MAX_LEAD_S:g} "
            "s; 'at' is the time at which it happened, as performance.now() shows it",
            is_clock=is_clock,
        )


class Exchange(NamedTuple):
    """One ping and its pong.

    Attributes
    ----------
    sent, received
        LSL times in seconds of the ping and the pong.
    at
        The browser's time in seconds of the pong.
    """

    sent: float
    at: float
    received: float

    @property
    def offset(self) -> float:
        """LSL's time minus the browser's, assuming equal delays of both messages."""
        return (self.sent + self.received) / 2 - self.at

    @property
    def half_s(self) -> float:
        """Largest error of the offset, if one message took the whole round trip."""
        return (self.received - self.sent) / 2


class LslTime(NamedTuple):
    """A browser's time on LSL's clock, and its uncertainty, in seconds."""

    lsl_time: float
    uncertainty_s: float


class BrowserClock:
    """The clock of one page, with an arbitrary zero.

    Each exchange determines the offset to within half of its round trip. The exchange with the
    smallest error is used, where the error grows with the drift since then. An exchange that
    contradicts it means that the clock was set, and the earlier ones are discarded.

    Parameters
    ----------
    resolution_s
        Resolution of the browser's clock in seconds. It counts twice, because each conversion
        compares two readings.
    """

    def __init__(self, resolution_s: float) -> None:
        self._resolution_s = min(max(resolution_s, 0.0), COARSEST_CLOCK_S)
        self._exchanges: deque[Exchange] = deque(maxlen=EXCHANGES_KEPT)

    @property
    def is_known(self) -> bool:
        """Whether times can be converted."""
        return len(self._exchanges) >= EXCHANGES_NEEDED

    @property
    def newest_uncertainty_s(self) -> float | None:
        """Uncertainty of a current time in seconds; None while the clock is not known."""
        if not self.is_known:
            return None
        return self.to_lsl(self._exchanges[-1].at).uncertainty_s

    def note(self, exchange: Exchange) -> bool:
        """Add an exchange; return False if it contradicts the earlier ones, which are discarded."""
        fits = not self._exchanges or self._fits(exchange)
        if not fits:
            self._exchanges.clear()
        self._exchanges.append(exchange)
        return fits

    def reset(self) -> None:
        """Discard all exchanges."""
        self._exchanges.clear()

    def to_lsl(self, at: float) -> LslTime:
        """Convert a time of the browser, in seconds, to LSL time.

        Raises
        ------
        ValueError
            If the clock is not known yet.
        """
        if not self.is_known:
            raise ValueError("the browser's clock is not measured yet")
        best = min(self._exchanges, key=lambda each: _error_s(each, at))
        return LslTime(at + best.offset, _error_s(best, at) + 2 * self._resolution_s)

    def _fits(self, exchange: Exchange) -> bool:
        best = min(self._exchanges, key=lambda each: _error_s(each, exchange.at))
        allowed = _error_s(best, exchange.at) + exchange.half_s + 2 * self._resolution_s
        return abs(exchange.offset - best.offset) <= allowed


def _error_s(exchange: Exchange, at: float) -> float:
    return exchange.half_s + CLOCK_DRIFT * abs(at - exchange.at)
