"""Requests and replies of the E4 server on a connection that also carries data."""

from __future__ import annotations

import asyncio

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.devices.empatica_e4.driver.messages import Message, Reply
from biosensor_gateway.devices.empatica_e4.driver.protocol import E4Protocol, request
from biosensor_gateway.transports.tcp_link import TcpLink

_LISTS = ("device_list", "device_discover_list")
_MAX_EARLY = 8192


class Conversation:
    """One TCP connection to a server.

    Data may come between a request and its reply; it is kept for `receive`.
    """

    def __init__(self, host: str, port: int) -> None:
        self._where = f"E4 server {host}:{port}"
        self._link = TcpLink(host, port)
        self._protocol = E4Protocol()
        self._early: list[tuple[list[Message], float]] = []
        self._reported_bytes = 0

    async def open(self) -> None:
        """Connect; see :meth:`TcpLink.open` for what it raises."""
        try:
            await self._link.open()
        except TransportError as error:
            if error.reason is not TransportReason.ABSENT:
                raise
            message = f"{self._where}: nothing answers; start the E4 streaming server there"
            raise TransportError(TransportReason.ABSENT, message) from error

    async def ask(self, command: str, *arguments: str, timeout_s: float) -> Reply:
        """Send a request and wait for its reply.

        Raises
        ------
        ProtocolError
            ``NO_REPLY``.
        TransportError
            ``LOST``.
        """
        self._link.write(request(command, *arguments))
        try:
            async with asyncio.timeout(timeout_s):
                while True:
                    messages, arrival = await self._read()
                    reply = next((each for each in messages if _answers(each, command)), None)
                    self._keep([each for each in messages if each is not reply], arrival)
                    if isinstance(reply, Reply):
                        return reply
        except TimeoutError as error:
            message = f"{self._where}: no answer to {command}; restart the server"
            raise ProtocolError(ProtocolReason.NO_REPLY, message) from error

    async def receive(self) -> tuple[list[Message], float]:
        """Wait for the next messages; return them and their LSL time of arrival.

        Raises
        ------
        TransportError
            ``LOST``.
        """
        return self._early.pop(0) if self._early else await self._read()

    def take_dropped_bytes(self) -> int:
        """Return how many bytes were dropped since the last call."""
        new = self._protocol.dropped_bytes - self._reported_bytes
        self._reported_bytes = self._protocol.dropped_bytes
        return new

    async def close(self) -> None:
        """Unbind without waiting, and close; never raises."""
        self._link.write(request("device_disconnect"))
        await self._link.close()

    async def _read(self) -> tuple[list[Message], float]:
        try:
            data, arrival = await self._link.read()
        except TransportError:
            self._protocol.finish()
            raise
        return self._protocol.feed(data), arrival

    def _keep(self, messages: list[Message], arrival: float) -> None:
        if messages and len(self._early) < _MAX_EARLY:
            self._early.append((messages, arrival))


def _answers(message: Message, command: str) -> bool:
    if not isinstance(message, Reply):
        return False
    # The vendor's documentation answers either list request with either word.
    return message.command == command or (command in _LISTS and message.command in _LISTS)
