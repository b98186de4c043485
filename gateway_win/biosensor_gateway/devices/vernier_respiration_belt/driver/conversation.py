"""Commands and replies over a Bluetooth link, with measurements in between."""

from __future__ import annotations

import asyncio
from typing import Any, NamedTuple

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.devices.vernier_respiration_belt.driver.messages import Message, Reply
from biosensor_gateway.devices.vernier_respiration_belt.driver.packets import encode, fragments
from biosensor_gateway.devices.vernier_respiration_belt.driver.protocol import (
    COMMAND_UUID,
    RESPONSE_UUID,
    Command,
    VernierProtocol,
)
from biosensor_gateway.devices.vernier_respiration_belt.driver.replies import REFUSED
from biosensor_gateway.transports.ble import BleLink, Notification
from biosensor_gateway.transports.deadlines import in_background

REPLY_LIMIT_S = 5.0
SETTLE_S = 0.1
TORN_PACKET_S = 1.0
"""Longest gap within a packet."""

_FIRST_COUNTER = 0xFF


class Heard(NamedTuple):
    """A message and the LSL time at which its last byte arrived."""

    message: Message
    arrival_s: float


class Answer(NamedTuple):
    """Payload of a reply and the LSL time at which it arrived."""

    payload: bytes
    arrival_s: float


class _Question(NamedTuple):
    command: int
    counter: int
    answer: asyncio.Future[Answer]


class Conversation:
    """What is said over one connection.

    Parameters
    ----------
    link
        Opened.
    sink
        Its ``dropped_bytes`` are counted here.
    """

    def __init__(self, link: BleLink, sink: Sink) -> None:
        self._link = link
        self._sink = sink
        self._protocol = VernierProtocol()
        self._arrival_s = 0.0
        self._heard: asyncio.Queue[Heard | Exception] = asyncio.Queue()
        self._listening: asyncio.Task[None] | None = None
        self._asking = asyncio.Lock()
        self._question: _Question | None = None
        self._counter = _FIRST_COUNTER
        self._with_response = "write" in link.properties(COMMAND_UUID)

    async def begin(self) -> None:
        """Listen, which must come before any command."""
        await self._link.subscribe(RESPONSE_UUID)
        self._listening = in_background(self._listen())
        await asyncio.sleep(SETTLE_S)

    async def next(self) -> Heard:
        """Wait for the next message, replies included.

        Raises
        ------
        TransportError
            ``LOST``, once everything that had arrived was taken.
        """
        heard = await self._heard.get()
        if isinstance(heard, Exception):
            self._heard.put_nowait(heard)
            raise heard
        return heard

    async def ask(self, body: bytes, limit_s: float = REPLY_LIMIT_S) -> Answer:
        """Give a command and wait for its reply.

        Raises
        ------
        ProtocolError
            ``NO_REPLY``.
        TransportError
            ``LOST`` or ``SILENT``.
        """
        async with self._asking:
            answer: asyncio.Future[Answer] = asyncio.get_running_loop().create_future()
            self._question = _Question(body[0], self._next_counter(), answer)
            try:
                await self._send(self._counter, body)
                await self._wait_for(answer, limit_s)
            finally:
                self._question = None
        if answer.done():
            return answer.result()
        message = f"{self._link.what} does not answer {_name(body)}; press its button"
        raise ProtocolError(ProtocolReason.NO_REPLY, message)

    async def order(self, body: bytes, limit_s: float = REPLY_LIMIT_S) -> None:
        """Give a command whose reply is a status; raises as :meth:`ask` does.

        Raises
        ------
        ProtocolError
            ``REFUSED`` as well.
        """
        payload = (await self.ask(body, limit_s)).payload
        if payload and payload[0] & REFUSED:
            command, status = _name(body), f"status 0x{payload[0]:02X}"
            message = f"{self._link.what} refuses {command} ({status}); switch it off and on"
            raise ProtocolError(ProtocolReason.REFUSED, message)

    async def tell(self, body: bytes) -> None:
        """Give a command without waiting for its reply.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        """
        await self._send(self._next_counter(), body)

    def end(self) -> None:
        """Listen no more."""
        if self._listening is not None:
            self._listening.cancel()

    async def _send(self, counter: int, body: bytes) -> None:
        for fragment in fragments(encode(counter, body)):
            await self._link.write(COMMAND_UUID, fragment, response=self._with_response)

    def _next_counter(self) -> int:
        self._counter = (self._counter - 1) % 256
        return self._counter

    async def _wait_for(self, answer: asyncio.Future[Answer], limit_s: float) -> None:
        listening = self._listening
        awaited: set[asyncio.Future[Any]] = {answer} if listening is None else {answer, listening}
        await asyncio.wait(awaited, timeout=limit_s, return_when=asyncio.FIRST_COMPLETED)
        if listening is not None and listening.done() and not answer.done():
            listening.result()

    async def _listen(self) -> None:
        try:
            while True:
                notification = await self._link.next()
                if notification.uuid == RESPONSE_UUID:
                    self._take(notification)
        except Exception as error:  # handed on to whoever waits for a reply
            self._heard.put_nowait(error)
            raise

    def _take(self, notification: Notification) -> None:
        before = self._protocol.dropped_bytes
        arrival_s = notification.arrival
        messages: list[Message] = []
        if self._protocol.buffered and arrival_s - self._arrival_s > TORN_PACKET_S:
            messages += self._protocol.give_up()
        messages += self._protocol.feed(notification.data)
        self._arrival_s = arrival_s
        self._sink.dropped_bytes += self._protocol.dropped_bytes - before
        for message in messages:
            if isinstance(message, Reply):
                self._answer(message, arrival_s)
            self._heard.put_nowait(Heard(message, arrival_s))

    def _answer(self, reply: Reply, arrival_s: float) -> None:
        asked = self._question
        if asked is None or (reply.command, reply.echo) != (asked.command, asked.counter):
            return
        if not asked.answer.done():
            asked.answer.set_result(Answer(reply.payload, arrival_s))


def _name(body: bytes) -> str:
    return Command(body[0]).name
