"""Commands and answers over a Bluetooth link, with packets of data in between."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.movesense.driver import protocol
from biosensor_gateway.devices.movesense.driver.measurements import HELLO_REFERENCE, Measurement
from biosensor_gateway.devices.movesense.driver.protocol import (
    COMMAND,
    DATA,
    Greeting,
    Kind,
    Message,
    parse_message,
)
from biosensor_gateway.transports.ble import BleLink, Notification
from biosensor_gateway.transports.dialogue import Dialogue

ANSWER_LIMIT_S = 5.0
REFUSAL_LIMIT_S = 0.5
RESTART_ADVICE = "restart the device: take it out of its strap for a minute"


class Conversation:
    """What is said over one connection.

    Parameters
    ----------
    link
    """

    def __init__(self, link: BleLink) -> None:
        self._link = link
        self._dialogue = Dialogue(self._receive, self._send)
        self._answers = True

    async def begin(self) -> Greeting:
        """Listen, and ask the device what it is.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        ProtocolError
            ``UNSUPPORTED`` by its firmware, ``NO_REPLY`` or ``REFUSED``.
        """
        if not (self._link.has(COMMAND) and self._link.has(DATA)):
            message = (
                f"{self._link.what} does not speak the GATT SensorData Protocol; update its "
                "firmware to 2.3 or newer with the Movesense app"
            )
            raise ProtocolError(ProtocolReason.UNSUPPORTED, message)
        # Before the first command, whose answer would be lost otherwise.
        await self._link.subscribe(DATA)
        self._dialogue.begin()
        answer = await self._ask(protocol.hello(HELLO_REFERENCE), HELLO_REFERENCE)
        if protocol.is_refused_greeting(answer.payload):
            message = f"{self._link.what} refuses to talk ({answer.status}); {RESTART_ADVICE}"
            raise ProtocolError(ProtocolReason.REFUSED, message)
        greeting = protocol.parse_greeting(answer.payload)
        self._answers = greeting.answers
        return greeting

    async def subscribe(self, measurement: Measurement) -> int:
        """Have the device send a measurement; return the status of a refusal, 0 if there is none.

        Firmware of the first version answers only where it has no room: without an answer it is
        taken at its word, and what does not come is noticed.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        ProtocolError
            ``NO_REPLY``.
        """
        command = protocol.subscribe(measurement.reference, measurement.path)
        if self._answers:
            answer = await self._ask(command, measurement.reference)
        else:
            answer = await self._asked(command, measurement.reference, REFUSAL_LIMIT_S)
        return answer.status if answer is not None and answer.is_refusal else 0

    async def unsubscribe(self, measurement: Measurement) -> None:
        """End a measurement without waiting for an answer; raises as :meth:`subscribe` does."""
        await self._send(protocol.unsubscribe(measurement.reference))

    async def stream(self, listener: Callable[[Sequence[Notification]], None]) -> None:
        """Pass on all notifications since `begin`, of other characteristics, too.

        Raises
        ------
        TransportError
            ``LOST``, once everything that had arrived was passed on.
        """
        await self._dialogue.stream(listener)

    async def close(self) -> None:
        """Listen no more."""
        await self._dialogue.close()

    async def _ask(self, command: bytes, reference: int) -> Message:
        found = await self._asked(command, reference, ANSWER_LIMIT_S)
        if found is None:
            message = f"{self._link.what}: no answer to a command; {RESTART_ADVICE}"
            raise ProtocolError(ProtocolReason.NO_REPLY, message)
        return found

    async def _asked(self, command: bytes, reference: int, limit_s: float) -> Message | None:
        def answer(notification: Notification) -> Message | None:
            message = _message(notification)
            if message is None or message.reference != reference:
                return None
            # Where data come, the answer to the subscription is lost or on its way.
            return message if message.kind in (Kind.ANSWER, Kind.DATA) else None

        return await self._dialogue.ask(command, answer, limit_s)

    async def _receive(self) -> Sequence[Notification]:
        return (await self._link.next(),)

    async def _send(self, command: bytes) -> None:
        await self._link.write(COMMAND, command)


def _message(notification: Notification) -> Message | None:
    return parse_message(notification.data) if notification.uuid == DATA else None
