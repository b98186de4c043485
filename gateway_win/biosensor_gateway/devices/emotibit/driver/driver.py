"""The conversation with one EmotiBit: find it, have it connect, keep it, pass on its data."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Literal

from pydantic import Field

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.driver import Connected, DriverEntry, own_settings
from biosensor_gateway.devices.emotibit.driver.advertising import (
    ADVERTISING_PORT,
    ANSWER_LIMIT_S,
    Advertising,
    Nearby,
)
from biosensor_gateway.devices.emotibit.driver.discovery import find
from biosensor_gateway.devices.emotibit.driver.emitter import EmotiBitEmitter
from biosensor_gateway.devices.emotibit.driver.link import (
    PING_EVERY_S,
    Arrived,
    Link,
    connect,
)
from biosensor_gateway.devices.emotibit.driver.packets import Packet, Tag
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.early import Early
from biosensor_gateway.transports.receiving import Address

PATIENCE_S = 3.0
_LOCAL_TIME = "%Y-%m-%d_%H-%M-%S-%f"


class EmotiBitSettings(DeviceSettings):
    """Settings of one EmotiBit."""

    device: str = Field(
        default="",
        description="Id of the EmotiBit, such as MD-V5-0000123; empty takes the only one that "
        "answers.",
    )
    host: str = Field(
        default="",
        description="Its address in the network; empty asks the whole network.",
        examples=["192.168.1.40"],
    )
    port: int = Field(
        default=ADVERTISING_PORT,
        ge=1,
        le=65535,
        description="UDP port on which EmotiBits are asked for.",
    )
    ppg_rate: Literal[25, 100] = Field(
        default=25,
        description="Samples of the pulse per second: 100 with the firmware of that name.",
    )


class EmotiBitDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`."""

    silence_limit_s = 8.0

    def __init__(self, settings: EmotiBitSettings, sink: Sink, emitter: EmotiBitEmitter) -> None:
        self._settings = settings
        self._sink = sink
        self._emitter = emitter
        self._advertising = Advertising(settings.host, settings.port)
        self._link: Link | None = None
        self._device: Address = ("", 0)
        # Connecting ends with the first read that has data.
        self._early = Early[Arrived](1)

    async def connect(self) -> Connected:
        """Find the EmotiBit and wait for its first data; see the protocol class."""
        await self._advertising.open()
        nearby = await self._find()
        self._device = nearby.address
        name = f"EmotiBit {nearby.device}" if nearby.device else f"EmotiBit {nearby.address[0]}"
        self._link = Link(name, nearby.address[0])
        await self._link.open()
        await connect(self._advertising, self._link, nearby)
        # It may have been left in a mode in which it sends nothing.
        self._link.control(Tag.NORMAL_POWER)
        self._emitter.connected()
        await self._first_data(self._link)
        info = DeviceInfo(serial_number=nearby.device)
        return Connected(info, {"ppg": self._settings.ppg_rate}, patience_s=PATIENCE_S)

    async def stream(self) -> None:
        """Emit what came while connecting, then all that comes."""
        if self._link is None:
            raise RuntimeError("a driver streams after it has connected")
        link = self._link
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._pass_on(link))
                tasks.create_task(self._ping(link))
                tasks.create_task(self._hear())
        except ExceptionGroup as group:
            raise group.exceptions[0] from None

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Ask for data once more; all streams have one switch; see the protocol class."""
        if self._link is not None:
            self._link.control(Tag.NORMAL_POWER)

    async def close(self) -> None:
        """Let the EmotiBit go, and close."""
        if self._link is not None:
            await self._link.close()
        self._advertising.close()

    async def _find(self) -> Nearby:
        wanted = self._settings.device
        found = await self._advertising.nearby(
            ANSWER_LIMIT_S, wanted, first=bool(self._settings.host)
        )
        chosen = [each for each in found if not wanted or each.is_called(wanted)]
        if len(chosen) == 1:
            return chosen[0]
        if chosen:
            names = ", ".join(sorted(each.device for each in chosen))
            message = f"several EmotiBits answer ({names}); set `device` to one"
            raise ProtocolError(ProtocolReason.REFUSED, message)
        others = ", ".join(sorted(each.device for each in found))
        name = f"EmotiBit {wanted}" if wanted else "EmotiBit"
        seen = f"; there are {others}" if others else ""
        where = f" at {self._settings.host}" if self._settings.host else " in the network"
        message = f"no {name} answers{where}{seen}; is it on, and in the same Wi-Fi?"
        raise TransportError(TransportReason.ABSENT, message)

    async def _first_data(self, link: Link) -> None:
        try:
            async with asyncio.timeout(ANSWER_LIMIT_S):
                while not self._early:
                    arrived = await link.read()
                    self._sink.dropped_bytes += arrived.found.dropped_bytes
                    if arrived.found.packets:
                        self._early.keep(arrived)
        except TimeoutError as error:
            message = f"{link.name}: it is connected and sends no data; switch it off and on"
            raise ProtocolError(ProtocolReason.NO_REPLY, message) from error

    async def _pass_on(self, link: Link) -> None:
        for arrived in self._early.take():
            self._take(link, arrived)
        while True:
            arrived = await link.read()
            self._sink.dropped_bytes += arrived.found.dropped_bytes
            self._take(link, arrived)

    def _take(self, link: Link, arrived: Arrived) -> None:
        packets = arrived.found.packets
        if packets:
            self._sink.heard()
            self._emitter.take(packets, arrived.arrival_s)
        for packet in packets:
            if packet.tag == Tag.REQUEST_DATA:
                _answer(link, packet, arrived.address)

    async def _ping(self, link: Link) -> None:
        while True:
            self._advertising.tell(Tag.PING, *link.data_payload, to=self._device)
            await asyncio.sleep(PING_EVERY_S)

    async def _hear(self) -> None:
        """Note that the device answers pings."""
        while True:
            packet, address = await self._advertising.hear()
            if packet.tag == Tag.PONG and address[0] == self._device[0]:
                self._sink.heard()


def _answer(link: Link, request: Packet, to: Address) -> None:
    """Tell an EmotiBit the time, which it notes in its file on its memory card."""
    now = datetime.now(UTC)
    if Tag.TIMESTAMP_LOCAL in request.payload:
        link.answer(Tag.TIMESTAMP_LOCAL, (now.astimezone().strftime(_LOCAL_TIME),), to)
    if Tag.TIMESTAMP_UTC in request.payload:
        link.answer(Tag.TIMESTAMP_UTC, (now.strftime(_LOCAL_TIME),), to)
    link.answer(Tag.ACK, (str(request.number), Tag.REQUEST_DATA), to)


def _make(settings: DeviceSettings, sink: Sink) -> Callable[[], EmotiBitDriver]:
    """Share one emitter between all connections: it follows losses across them."""
    own = own_settings(EmotiBitSettings, settings)
    emitter = EmotiBitEmitter(sink, own.ppg_rate)
    return lambda: EmotiBitDriver(own, sink, emitter)


DRIVER = DriverEntry(EmotiBitSettings, _make, find=find)
