"""One connection to a Bluetooth LE sensor, which may mix answers and data."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Generator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, Generic, TypeVar

from biosensor_common.errors import (
    GatewayError,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.transports.ble import BleLink, Notification
from biosensor_gateway.transports.dialogue import Dialogue

GOODBYE_LIMIT_S = 0.45
"""Time for the last commands: a driver must close within half a second."""

_MessageT = TypeVar("_MessageT")
_CommandT = TypeVar("_CommandT")
_AnswerT = TypeVar("_AnswerT")


class BleConnection:
    """A link to a device that only sends, from connecting to the last requests."""

    def __init__(self, link: BleLink) -> None:
        self.link = link
        self._signal: tuple[int | None, float] = (None, 0.0)

    async def connect(self) -> None:
        """Find the device and connect to it; raises like :meth:`BleLink.open`."""
        seen = await self.link.open()
        self._signal = (seen.rssi_dbm, self.link.clock())

    async def run(
        self,
        take_signal: Callable[[int | None, float], None],
        *tasks: Callable[[], Coroutine[Any, Any, None]],
    ) -> None:
        """Run tasks as long as the connection, such as listening or reading the battery.

        Parameters
        ----------
        take_signal
            Called first with the signal strength before the connection, and its time.

        Raises
        ------
        TransportError
            ``LOST``, after everything received was passed on.
        """
        take_signal(*self._signal)
        async with asyncio.TaskGroup() as group:
            for each in tasks:
                group.create_task(each())

    async def listen(self, take: Callable[[Notification], None]) -> None:
        """Pass on each notification, starting with those that the link has buffered."""
        while True:
            take(await self.link.next())

    async def close(self, say_goodbye: Callable[[], Awaitable[None]]) -> None:
        """Stop the device without waiting for answers, and disconnect; never raises."""
        with suppress(GatewayError, TimeoutError):
            async with asyncio.timeout(GOODBYE_LIMIT_S):
                await say_goodbye()
        await self._end()

    async def _end(self) -> None:
        await self.link.close()


class BleSession(BleConnection, Generic[_MessageT, _CommandT]):
    """A connection with its dialogue.

    A subclass starts the dialogue after subscribing, and defines the commands.

    Parameters
    ----------
    receive, send
        As of the `Dialogue`.
    advice
        Advice for the user about a device that does not answer; a clause.
    """

    def __init__(
        self,
        link: BleLink,
        receive: Callable[[], Awaitable[Sequence[_MessageT]]],
        send: Callable[[_CommandT], Awaitable[None]],
        advice: str,
    ) -> None:
        super().__init__(link)
        self.dialogue = Dialogue(receive, send)
        self._advice = advice

    async def ask(
        self,
        command: _CommandT,
        match: Callable[[_MessageT], _AnswerT | None],
        limit_s: float,
        failure: str = "no answer to a command",
    ) -> _AnswerT:
        """Send a command and return what `match` makes of its answer.

        Parameters
        ----------
        match, limit_s
            As in :meth:`Dialogue.ask`.
        failure
            Clause for the error that there is no answer.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        ProtocolError
            ``NO_REPLY``, or the device refuses the command.
        """
        answer = await self.dialogue.ask(command, match, limit_s)
        if answer is None:
            message = f"{self.link.what}: {failure}; {self._advice}"
            raise ProtocolError(ProtocolReason.NO_REPLY, message)
        return answer

    async def stream(
        self,
        take: Callable[[Sequence[_MessageT]], None],
        take_signal: Callable[[int | None, float], None],
        *alongside: Callable[[], Coroutine[Any, Any, None]],
    ) -> None:
        """Pass on everything received since the dialogue started.

        Parameters
        ----------
        take
            Called with the messages of each read, including answers.
        take_signal, alongside
            As of :meth:`run`, which raises the same.
        """
        await self.run(take_signal, *alongside, partial(self.dialogue.stream, take))

    async def _end(self) -> None:
        await self.dialogue.close()
        await super()._end()


@contextmanager
def optional_request(log: Callable[[str], None] | None = None) -> Generator[None]:
    """Ignore a refused or unanswered request, as long as the connection stands.

    Parameters
    ----------
    log
        Called with the refusal; None to ignore it silently.
    """
    try:
        yield
    except ProtocolError as error:
        if log is not None:
            log(str(error))
    except TransportError as error:
        # If the silence lasts, the watchdog of the streams reports it.
        if error.reason is not TransportReason.SILENT:
            raise
