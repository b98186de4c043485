"""One connection to a Bluetooth LE sensor that answers among its data."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Generator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, Generic, TypeVar

from biosensor_common.errors import (
    GatewayError,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.dialogue import Dialogue

GOODBYE_LIMIT_S = 0.45
"""A driver has half a second to close; what the device does not hear by then is left unsaid."""

_MessageT = TypeVar("_MessageT")
_CommandT = TypeVar("_CommandT")
_AnswerT = TypeVar("_AnswerT")


class BleSession(Generic[_MessageT, _CommandT]):
    """A link and the dialogue on it, from the connection to the goodbye.

    A subclass begins the dialogue when it has subscribed, and says what is asked.

    Parameters
    ----------
    receive, send
        As of the `Dialogue`.
    advice
        What helps a device that does not answer; a clause for a person.
    """

    def __init__(
        self,
        link: BleLink,
        receive: Callable[[], Awaitable[Sequence[_MessageT]]],
        send: Callable[[_CommandT], Awaitable[None]],
        advice: str,
    ) -> None:
        self.link = link
        self.dialogue = Dialogue(receive, send)
        self._advice = advice
        self._signal: tuple[int | None, float] = (None, 0.0)

    async def connect(self) -> None:
        """Find the device and connect to it; raises as :meth:`BleLink.open` does."""
        seen = await self.link.open()
        self._signal = (seen.rssi_dbm, self.link.clock())

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
            As of :meth:`Dialogue.ask`.
        failure
            Says that there is no answer; a clause.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        ProtocolError
            ``NO_REPLY``, or the device refuses to take the command.
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
        """Pass on what came since the dialogue began, then all that comes.

        Parameters
        ----------
        take
            Gets the messages of each read, answers included.
        take_signal
            Gets how strongly the device was heard before it was connected, and when.
        alongside
            What else runs as long as the connection: batteries to read, refusals to ask about.

        Raises
        ------
        TransportError
            ``LOST``, once everything that had arrived was passed on.
        """
        take_signal(*self._signal)
        async with asyncio.TaskGroup() as tasks:
            for each in alongside:
                tasks.create_task(each())
            tasks.create_task(self.dialogue.stream(take))

    async def close(self, say_goodbye: Callable[[], Awaitable[None]]) -> None:
        """Stop the device, without waiting for its answers, and disconnect; never raises."""
        with suppress(GatewayError, TimeoutError):
            async with asyncio.timeout(GOODBYE_LIMIT_S):
                await say_goodbye()
        await self.dialogue.close()
        await self.link.close()


@contextmanager
def optional_request(log: Callable[[str], None] | None = None) -> Generator[None]:
    """Go on without what is refused or not answered, as long as the connection stands.

    Parameters
    ----------
    log
        Gets what the device refuses; None where nobody needs to know.
    """
    try:
        yield
    except ProtocolError as error:
        if log is not None:
            log(str(error))
    except TransportError as error:
        # Whether the silence lasts, the watchdog of the streams tells.
        if error.reason is not TransportReason.SILENT:
            raise
