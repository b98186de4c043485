"""Commands and answers over a Bluetooth link, with packets of data in between."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.muse.driver import commands
from biosensor_gateway.devices.muse.driver.commands import Answer, Answers
from biosensor_gateway.devices.muse.driver.gatt import CONTROL
from biosensor_gateway.transports.ble import BleLink, Notification
from biosensor_gateway.transports.dialogue import Dialogue

ANSWER_LIMIT_S = 5.0


class Conversation:
    """What is said over one connection.

    Parameters
    ----------
    link
    """

    def __init__(self, link: BleLink) -> None:
        self._link = link
        # One for all questions: a packet may end an answer and begin the next one.
        self._answers = Answers()
        self._fresh: list[Answer] = []
        self._dialogue: Dialogue[Notification, str] = Dialogue(self._receive, self.tell)

    async def begin(self) -> None:
        """Listen to answers.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        ProtocolError
            ``UNSUPPORTED``: it is no Muse of these generations.
        """
        # Before the first command, whose answer would be lost otherwise.
        await self._link.subscribe(CONTROL)
        self._dialogue.begin()

    async def ask(self, command: str, key: str = "rc") -> Answer:
        """Send a command and return its answer.

        Parameters
        ----------
        command
        key
            A field that the answer has, and no other one: an earlier one may come late.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        ProtocolError
            ``NO_REPLY`` or ``REFUSED``.
        """

        def match(notification: Notification) -> Answer | None:
            if notification.uuid != CONTROL:
                return None
            fits = (each for each in self._fresh if key in each or commands.return_code(each))
            return next(fits, None)

        answer = await self._dialogue.ask(command, match, ANSWER_LIMIT_S)
        if answer is None:
            message = f"{self._link.what}: no answer to the command {command}; switch it off and on"
            raise ProtocolError(ProtocolReason.NO_REPLY, message)
        code = commands.return_code(answer)
        if code:
            message = (
                f"{self._link.what} refuses the command {command} ({code}); switch it off and on, "
                "and leave preset empty in its settings"
            )
            raise ProtocolError(ProtocolReason.REFUSED, message)
        return answer

    async def tell(self, command: str) -> None:
        """Send a command without waiting for its answer; raises as `ask` does."""
        await self._link.write(CONTROL, commands.encode(command), response=False)

    async def stream(self, listener: Callable[[Sequence[Notification]], None]) -> None:
        """Pass on all notifications since `begin`.

        Raises
        ------
        TransportError
            ``LOST``, once everything that had arrived was passed on.
        """
        await self._dialogue.stream(listener)

    async def close(self) -> None:
        """Listen no more."""
        await self._dialogue.close()

    async def _receive(self) -> Sequence[Notification]:
        notification = await self._link.next()
        if notification.uuid == CONTROL:
            first = self._answers.feed(notification.data)
            self._fresh = [] if first is None else [first, *self._answers.complete]
        return (notification,)
