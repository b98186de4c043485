"""Talks with one page of a web experiment: measures its clock, and takes its markers."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Coroutine
from typing import Any

from fastapi import WebSocket, WebSocketDisconnect
from pydantic import ValidationError
from pylsl import local_clock

from biosensor_common.errors import GatewayError, TransportError
from biosensor_gateway.page.experiments.browser_clock import BrowserClock, Exchange
from biosensor_gateway.page.experiments.marked_time import MarkedTime, RefusedTimeError
from biosensor_gateway.page.experiments.models import MESSAGE, Hello, Mark, Pong, Sent
from biosensor_gateway.page.experiments.sending import Pace, Sending, WebMark
from biosensor_gateway.page.experiments.token import is_same
from biosensor_gateway.page.guard import REFUSED_SOCKET
from biosensor_gateway.page.marker_models import ExperimentView

HELLO_WITHIN_S = 5.0
PINGS_FIRST, FIRST_EVERY_S = 8, 0.03
PING_EVERY_S, UNTIL_KNOWN_EVERY_S = 2.0, 0.25
MESSAGES_PER_S, MESSAGES_AT_ONCE = 200, 400
MARKS_WAITING = 64
_PINGS_OPEN = 16


class Conversation:
    """What is said on one WebSocket.

    Parameters
    ----------
    socket
    origin
        Of the page, which the guard has let in.
    token
        What it has to know.
    sending
        Where its markers go.
    """

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
        self._is_set_anew = asyncio.Event()
        self._pace = Pace(MESSAGES_PER_S, MESSAGES_AT_ONCE)

    @property
    def view(self) -> ExperimentView:
        """Who is there."""
        return ExperimentView(origin=self._origin, uncertainty_s=self._clock.newest_uncertainty_s)

    async def run(self) -> None:
        """Talk until the page goes away, or says what nobody understands."""
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
        """Return what is wrong with the first message; empty if nothing is."""
        try:
            async with asyncio.timeout(HELLO_WITHIN_S):
                hello = Hello.model_validate_json(await self._socket.receive_text())
        except (ValidationError, KeyError, TimeoutError):
            return "the first message is hello, with the token"
        except WebSocketDisconnect:
            return "gone"
        if not is_same(hello.token, self._token):
            return "the token is wrong; biosensor-gateway mark --web shows the right one"
        self._client = hello.client
        self._clock = BrowserClock(hello.resolution_ms / 1000)
        self._time = MarkedTime(self._clock)
        return ""

    async def _receive(self) -> str:
        """Take messages in; return why there will be no more."""
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
            return "a message is none of pong and mark as documented"
        except WebSocketDisconnect:
            return "gone"

    def _note(self, pong: Pong, arrival: float) -> None:
        asked = self._asked.pop(pong.n, None)
        if asked is not None and not self._clock.note(Exchange(asked, pong.at / 1000, arrival)):
            self._is_set_anew.set()

    async def _take(self, mark: Mark, arrival: float) -> None:
        try:
            self._marks.put_nowait((mark, arrival))
        except asyncio.QueueFull:
            await self._refuse(mark, "too many markers wait already", again=True)

    async def _measure(self) -> None:
        """Ask for the browser's time: some times at first, and every two seconds then."""
        number, is_known = 0, False
        while True:
            self._is_set_anew.clear()
            for _ in range(PINGS_FIRST):
                number += 1
                await self._ping(number)
                await asyncio.sleep(FIRST_EVERY_S)
            while not self._is_set_anew.is_set():
                if self._clock.is_known and not is_known:
                    is_known = True
                    await self._say(type="ready", uncertainty_s=self._clock.newest_uncertainty_s)
                with contextlib.suppress(TimeoutError):
                    pause_s = PING_EVERY_S if self._clock.is_known else UNTIL_KNOWN_EVERY_S
                    async with asyncio.timeout(pause_s):
                        await self._is_set_anew.wait()
                number += 1
                await self._ping(number)

    async def _ping(self, number: int) -> None:
        if len(self._asked) >= _PINGS_OPEN:
            # A page that is busy answers all of them at once; the newest are the best.
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
                    self._is_set_anew.set()
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
    """Talk as long as somebody is there; whoever receives learns first that nobody is."""
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        await talking
