"""Requests and replies of the E4 server on a connection that also carries data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.devices.empatica_e4.driver.messages import Message, Reply
from biosensor_gateway.devices.empatica_e4.driver.protocol import E4Protocol, request
from biosensor_gateway.transports.dialogue import Dialogue
from biosensor_gateway.transports.tcp_link import TcpLink

_LISTS = ("device_list", "device_discover_list")


class Heard(NamedTuple):
    """A message and the LSL time at which it arrived."""

    message: Message
    arrival_s: float


class Conversation:
    """One TCP connection to a server."""

    def __init__(self, host: str, port: int) -> None:
        self._where = f"E4 server {host}:{port}"
        self._link = TcpLink(host, port)
        self._protocol = E4Protocol()
        self._dialogue = Dialogue(self._receive, self._link.write)
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
        self._dialogue.begin()

    async def ask(self, command: str, *arguments: str, timeout_s: float) -> Reply:
        """Send a request and wait for its reply.

        Raises
        ------
        ProtocolError
            ``NO_REPLY``.
        TransportError
            ``LOST``.
        """

        def answer(heard: Heard) -> Reply | None:
            message = heard.message
            return message if isinstance(message, Reply) and _answers(message, command) else None

        reply = await self._dialogue.ask(request(command, *arguments), answer, timeout_s)
        if reply is None:
            message = f"{self._where}: no answer to {command}; restart the server"
            raise ProtocolError(ProtocolReason.NO_REPLY, message)
        return reply

    def tell(self, command: str, *arguments: str) -> None:
        """Send a request whose reply nobody waits for."""
        self._link.write(request(command, *arguments))

    async def stream(self, listener: Callable[[Sequence[Heard]], None]) -> None:
        """Pass on all messages since `open`, those of a read at a time.

        Raises
        ------
        TransportError
            ``LOST``.
        """
        await self._dialogue.stream(listener)

    def take_dropped_bytes(self) -> int:
        """Return how many bytes were dropped since the last call."""
        new = self._protocol.dropped_bytes - self._reported_bytes
        self._reported_bytes = self._protocol.dropped_bytes
        return new

    async def close(self) -> None:
        """Unbind without waiting, and close; never raises."""
        self.tell("device_disconnect")
        await self._dialogue.close()
        await self._link.close()

    async def _receive(self) -> list[Heard]:
        try:
            data, arrival = await self._link.read()
        except TransportError:
            self._protocol.finish()
            raise
        return [Heard(message, arrival) for message in self._protocol.feed(data)]


def _answers(message: Reply, command: str) -> bool:
    # The vendor's documentation answers either list request with either word.
    return message.command == command or (command in _LISTS and message.command in _LISTS)
