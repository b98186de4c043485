"""Commands and replies on a connection that also carries data."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import (
    CONTROL_POINT,
    Reply,
    parse_features,
    parse_indication,
)
from biosensor_gateway.devices.polar_h10.driver.protocol.frames import DATA
from biosensor_gateway.transports.ble import BleLink, Notification

REPLY_TIMEOUT_S = 5.0


class ControlPoint:
    """The control point of one connection; one command at a time.

    While it waits for a reply it is the one who reads the link.

    Parameters
    ----------
    link
    pass_on
        Gets every other notification that comes meanwhile.
    """

    def __init__(self, link: BleLink, pass_on: Callable[[Notification], None]) -> None:
        self._link = link
        self._pass_on = pass_on
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
        features = parse_features(await self._link.read(CONTROL_POINT))
        self._knocking = True
        # Before the first command, which is refused or never answered otherwise.
        await self._link.subscribe(CONTROL_POINT)
        await self._link.subscribe(DATA)
        return features

    async def request(self, command: bytes) -> Reply:
        """Send a command and return its reply, whatever its status, with all parameters.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        AttError
            The device refuses to take the command.
        ProtocolError
            ``NO_REPLY``.
        """
        await self._flush()
        await self._link.write(CONTROL_POINT, command)
        self._open = True
        try:
            async with asyncio.timeout(REPLY_TIMEOUT_S):
                return await self._reply(command)
        except TimeoutError as error:
            message = f"{self._link.what}: no answer to a command; take it off for a minute"
            raise ProtocolError(ProtocolReason.NO_REPLY, message) from error

    async def send(self, command: bytes) -> None:
        """Send a command and wait for no reply; raises as `open` does."""
        await self._link.write(CONTROL_POINT, command)

    async def close(self) -> None:
        """Unsubscribe; raises as `open` does."""
        await self._link.unsubscribe(DATA)
        await self._link.unsubscribe(CONTROL_POINT)

    async def _flush(self) -> None:
        """Pass on what has arrived: a reply that came too late must not answer for the next."""
        try:
            async with asyncio.timeout(0):
                while True:
                    self._pass_on(await self._link.next())
        except TimeoutError:
            return

    async def _reply(self, command: bytes) -> Reply:
        parameters = b""
        while True:
            notification = await self._link.next()
            reply = _reply_to(command, notification)
            if reply is None:
                self._pass_on(notification)
                continue
            parameters += reply.parameters
            if not reply.more:
                return replace(reply, parameters=parameters)


def _reply_to(command: bytes, notification: Notification) -> Reply | None:
    if notification.uuid != CONTROL_POINT:
        return None
    message = parse_indication(notification.data)
    if not isinstance(message, Reply):
        return None
    return message if bytes([message.operation, message.measurement]) == command[:2] else None
