"""Sends commands to a device that streams: one reader for answers and data."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

from biosensor_gateway.transports.link import Early
from biosensor_gateway.transports.threads import in_background

KEPT_READS = 8192
"""Reads that wait for a listener; a device may talk for half a minute before there is one."""

_MessageT = TypeVar("_MessageT")
_CommandT = TypeVar("_CommandT")
_AnswerT = TypeVar("_AnswerT")


class Heard(NamedTuple, Generic[_MessageT]):
    """A message and the LSL time at which its last byte arrived."""

    message: _MessageT
    arrival_s: float


class Dialogue(Generic[_MessageT, _CommandT]):
    """Commands and answers on a link that also carries data; one command at a time.

    One task reads, from `begin` to `close`. The listener gets all messages in order, including
    answers: devices number them together with their data, and some answers are readings.
    Messages that arrive before there is a listener are kept for it.

    Parameters
    ----------
    receive
        Waits for the next messages; an exception ends the dialogue.
    send
        Sends a command, at once or when awaited.
    """

    def __init__(
        self,
        receive: Callable[[], Awaitable[Sequence[_MessageT]]],
        send: Callable[[_CommandT], Awaitable[None] | None],
    ) -> None:
        self._receive = receive
        self._send = send
        self._listener: Callable[[Sequence[_MessageT]], None] = self._keep
        self._early = Early[Sequence[_MessageT]](KEPT_READS)
        self._turn = asyncio.Lock()
        self._is_answer: Callable[[_MessageT], bool] | None = None
        self._reading: asyncio.Task[None] | None = None

    def begin(self) -> None:
        """Start reading."""
        self._reading = in_background(self._read_forever())

    async def ask(
        self, command: _CommandT, match: Callable[[_MessageT], _AnswerT | None], limit_s: float
    ) -> _AnswerT | None:
        """Send a command and wait for its answer.

        Parameters
        ----------
        match
            Called with each message, before the listener and before later messages; returns the
            answer once it is complete.
        limit_s
            Time limit for the answer after the command was sent.

        Returns
        -------
        object or None
            The result of `match`; None if there was no answer in time.

        Raises
        ------
        Exception
            The exception of `send`, or the one that ended the reading.
        """
        async with self._turn:
            # What has arrived by now answers something else: let the reader pass it on.
            await asyncio.sleep(0)
            reading = self._require_reader()
            answer: asyncio.Future[_AnswerT] = asyncio.get_running_loop().create_future()

            def is_answer(message: _MessageT) -> bool:
                found = match(message)
                if found is not None:
                    answer.set_result(found)
                return found is not None

            self._is_answer = is_answer
            try:
                await self._tell(command)
                awaited: set[asyncio.Future[Any]] = {answer, reading}
                await asyncio.wait(awaited, timeout=limit_s, return_when=asyncio.FIRST_COMPLETED)
            finally:
                self._is_answer = None
        if answer.done():
            return answer.result()
        self._require_reader()
        return None

    async def stream(self, listener: Callable[[Sequence[_MessageT]], None]) -> None:
        """Pass on all messages, including earlier ones, until the reading ends.

        Parameters
        ----------
        listener
            Called with the messages of each read.

        Raises
        ------
        Exception
            The exception of `receive` or of the listener.
        """
        for messages in self._early.take():
            listener(messages)
        self._listener = listener
        reading = self._require_reader()
        try:
            await asyncio.wait({reading})
        finally:
            self._listener = _pass_over
        reading.result()

    def hear(self, messages: Sequence[_MessageT]) -> None:
        """Process messages as if they had just been read."""
        for message in messages:
            if self._is_answer is not None and self._is_answer(message):
                self._is_answer = None
        self._listener(messages)

    async def close(self) -> None:
        """Stop reading; never raises."""
        if self._reading is not None:
            self._reading.cancel()
            await asyncio.wait({self._reading})

    async def _read_forever(self) -> None:
        while True:
            self.hear(await self._receive())

    async def _tell(self, command: _CommandT) -> None:
        sending = self._send(command)
        if sending is not None:
            await sending

    def _require_reader(self) -> asyncio.Task[None]:
        """Return the reading task; raise the exception that ended it."""
        if self._reading is None:
            raise RuntimeError("nobody reads before a dialogue has started")
        if self._reading.done():
            self._reading.result()
        return self._reading

    def _keep(self, messages: Sequence[_MessageT]) -> None:
        if messages:
            self._early.keep(messages)


def _pass_over(_messages: Sequence[object]) -> None:
    """Discard messages after the stream has ended."""
