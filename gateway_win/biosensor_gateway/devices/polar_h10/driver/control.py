"""Commands to the control point, and their replies."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace

from biosensor_gateway.devices.ble_session import BleSession
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import (
    CONTROL_POINT,
    Reply,
    parse_features,
    parse_indication,
)
from biosensor_gateway.devices.polar_h10.driver.protocol.frames import DATA
from biosensor_gateway.transports.ble import BleLink, Notification

REPLY_TIMEOUT_S = 5.0
_ADVICE = "take it off for a minute"


def _unnoted(_reply: Reply) -> None:
    """Change nothing because of a reply."""


class ControlPoint(BleSession[Notification, bytes]):
    """The control point of one connection.

    Parameters
    ----------
    receive
        Waits for what the device sends, by its replies and by itself.
    """

    def __init__(
        self, link: BleLink, receive: Callable[[], Awaitable[Sequence[Notification]]]
    ) -> None:
        super().__init__(link, receive, self._write, _ADVICE)
        self._knocking = False
        self._open = False

    @property
    def knocking(self) -> bool:
        """Whether something was written, a subscription or a command, and no command came through.

        A device that demands to be paired may refuse the one or the other.
        """
        return self._knocking and not self._open

    async def open(self) -> frozenset[int]:
        """Subscribe to replies and data; return which measurements the device offers.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        AttError
            The device refuses; it may want to be paired.
        """
        # Before the subscription: BlueZ passes a value that is read on as a notification, too.
        features = parse_features(await self.link.read(CONTROL_POINT))
        self._knocking = True
        # Before the first command, which is refused or never answered otherwise.
        await self.link.subscribe(CONTROL_POINT)
        await self.link.subscribe(DATA)
        return features

    async def request(self, command: bytes, note: Callable[[Reply], None] = _unnoted) -> Reply:
        """Send a command and return its reply, whatever its status, with all parameters.

        Parameters
        ----------
        note
            Gets the reply before anybody gets what the device sends behind it.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        AttError
            The device refuses to take the command.
        ProtocolError
            ``NO_REPLY``.
        """
        return await self.ask(command, _ReplyTo(command, note).take, REPLY_TIMEOUT_S)

    async def send(self, command: bytes) -> None:
        """Send a command and wait for no reply; raises as `open` does."""
        await self.link.write(CONTROL_POINT, command)

    async def unsubscribe(self) -> None:
        """Listen no more; raises as `open` does."""
        await self.link.unsubscribe(DATA)
        await self.link.unsubscribe(CONTROL_POINT)

    async def _write(self, command: bytes) -> None:
        await self.link.write(CONTROL_POINT, command)
        self._open = True


class _ReplyTo:
    """Finds the reply to a command, which may come in several packets."""

    def __init__(self, command: bytes, note: Callable[[Reply], None]) -> None:
        self._asked = command[:2]
        self._note = note
        self._parameters = b""

    def take(self, notification: Notification) -> Reply | None:
        if notification.uuid != CONTROL_POINT:
            return None
        part = parse_indication(notification.data)
        if not isinstance(part, Reply) or bytes([part.operation, part.measurement]) != self._asked:
            return None
        self._parameters += part.parameters
        if part.more:
            return None
        reply = replace(part, parameters=self._parameters)
        self._note(reply)
        return reply
