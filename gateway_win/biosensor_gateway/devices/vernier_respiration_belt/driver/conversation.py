"""Commands and replies over a Bluetooth link, mixed with measurements."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.ble_session import BleSession
from biosensor_gateway.devices.vernier_respiration_belt.driver.protocol import (
    COMMAND_UUID,
    REFUSED,
    RESPONSE_UUID,
    Channel,
    Command,
    Message,
    Reply,
    VernierProtocol,
    encode,
    fragments,
)
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.dialogue import Heard

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

REPLY_LIMIT_S = 5.0
SETTLE_S = 0.1
TORN_PACKET_S = 1.0
"""Longest gap within a packet."""

_FIRST_COUNTER = 0xFF


class Answer(NamedTuple):
    """Payload of a reply and the LSL time at which it arrived."""

    payload: bytes
    arrival_s: float


class _Command(NamedTuple):
    counter: int
    body: bytes

    def answer(self, heard: Heard[Message]) -> Answer | None:
        message = heard.message
        if isinstance(message, Reply) and (message.command, message.echo) == (
            self.body[0],
            self.counter,
        ):
            return Answer(message.payload, heard.arrival_s)
        return None


class Conversation(BleSession[Heard[Message], _Command]):
    """The commands and replies of one connection.

    Parameters
    ----------
    sink
        Its ``dropped_bytes`` are increased here.
    """

    def __init__(self, link: BleLink, sink: DeviceSink) -> None:
        super().__init__(link, self._receive, self._send, "press its button")
        self._sink = sink
        self._protocol = VernierProtocol()
        self._arrival_s = 0.0
        self._counter = _FIRST_COUNTER
        self._with_response = True

    async def begin(self) -> None:
        """Subscribe, which must precede any command."""
        self._with_response = "write" in self.link.properties(COMMAND_UUID)
        await self.link.subscribe(RESPONSE_UUID)
        self.dialogue.begin()
        await asyncio.sleep(SETTLE_S)

    async def query(self, body: bytes, limit_s: float = REPLY_LIMIT_S) -> Answer:
        """Send a command and wait for its reply.

        Raises
        ------
        ProtocolError
            ``NO_REPLY``.
        TransportError
            ``LOST`` or ``SILENT``.
        """
        command = self._numbered(body)
        failure = f"it does not answer {_name(body)}"
        return await self.ask(command, command.answer, limit_s, failure)

    async def order(self, body: bytes, limit_s: float = REPLY_LIMIT_S) -> None:
        """Send a command whose reply is a status; raises like :meth:`query`.

        Raises
        ------
        ProtocolError
            Also ``REFUSED``.
        """
        payload = (await self.query(body, limit_s)).payload
        if payload and payload[0] & REFUSED:
            command, status = _name(body), f"status 0x{payload[0]:02X}"
            message = f"{self.link.what} refuses {command} ({status}); switch it off and on"
            raise ProtocolError(ProtocolReason.REFUSED, message)

    async def tell(self, body: bytes) -> None:
        """Send a command without waiting for its reply.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        """
        await self._send(self._numbered(body))

    async def _send(self, command: _Command) -> None:
        for fragment in fragments(encode(command.counter, command.body)):
            await self.link.write(COMMAND_UUID, fragment, response=self._with_response)

    def _numbered(self, body: bytes) -> _Command:
        self._counter = (self._counter - 1) % 256
        return _Command(self._counter, body)

    async def _receive(self) -> list[Heard[Message]]:
        notification = await self.link.next()
        if notification.uuid != RESPONSE_UUID:
            return []
        before = self._protocol.dropped_bytes
        arrival_s = notification.arrival
        messages: list[Message] = []
        if self._protocol.buffered and arrival_s - self._arrival_s > TORN_PACKET_S:
            messages += self._protocol.give_up()
        messages += self._protocol.feed(notification.data)
        self._arrival_s = arrival_s
        self._sink.dropped_bytes += self._protocol.dropped_bytes - before
        return [Heard(message, arrival_s) for message in messages]


def _name(body: bytes) -> str:
    return Command(body[0]).name


@dataclass(frozen=True, slots=True)
class BeltChannels:
    """The channels for force, and for the respiration rate that the belt computes."""

    force: Channel
    rate: Channel

    @property
    def mask(self) -> int:
        """Both channels as a mask, bit n for channel n."""
        return 1 << self.force.number | 1 << self.rate.number

    def period_us(self, wanted_us: int) -> int:
        """Return the possible sample period nearest to the wanted one.

        A belt measures all channels with the same period.
        """
        both = (self.force, self.rate)
        least = max(channel.min_period_us for channel in both)
        most = max(least, min(channel.max_period_us for channel in both))
        step = max(1, *(channel.granularity_us for channel in both))
        period = round(min(max(wanted_us, least), most) / step) * step
        if period < least:
            return period + step
        return period - step if period > most and period - step >= least else period


def choose_channels(channels: Sequence[Channel]) -> BeltChannels:
    """Find the channels for force and rate by their descriptions.

    Raises
    ------
    ProtocolError
        ``UNSUPPORTED``, if one of them is missing.
    """
    force = [each for each in channels if each.description.casefold() == "force"]
    rate = [each for each in channels if each.description.casefold() == "respiration rate"]
    if not force or not rate:
        names = ", ".join(each.description for each in channels) or "nothing"
        message = f"the device measures {names}: it is not a respiration belt; set another `device`"
        raise ProtocolError(ProtocolReason.UNSUPPORTED, message)
    return BeltChannels(force[0], rate[0])
