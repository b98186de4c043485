"""Driver for the EmotiBit: finds it, lets it connect, keeps the connection, emits its data."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.driver import Connected, DriverEntry, Found, own_settings
from biosensor_gateway.devices.emotibit.driver.emitter import EmotiBitEmitter
from biosensor_gateway.devices.emotibit.driver.link import (
    ADVERTISING_PORT,
    ANSWER_LIMIT_S,
    PING_EVERY_S,
    Advertising,
    Arrived,
    Link,
    Nearby,
    connect,
)
from biosensor_gateway.devices.emotibit.driver.protocol import NUMBERS, Packet, Tag
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.link import Address, Early

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

PATIENCE_S = 3.0
RATE_LIMIT_S = 2.0
"""Without pulse data until then, the rate in the settings is assumed to be right."""
# Packets needed to accept a rate, and to reject it, because reading may be late.
_LEAST_PACKETS, _CERTAIN_PACKETS = 4, 10
_RATE_TOLERANCE = 0.3
_RATES = (25, 100)
_MOST_EARLY = 1024
_LOCAL_TIME = "%Y-%m-%d_%H-%M-%S-%f"
_LISTEN_S = 1.5


class EmotiBitSettings(DeviceSettings):
    """Settings of one EmotiBit."""

    device: str = Field(
        default="",
        description="Id of the EmotiBit, such as MD-V5-0000123; if empty, the only one that "
        "answers.",
    )
    host: str = Field(
        default="",
        description="Its address in the network; if empty, the whole network is asked.",
        examples=["192.168.1.40"],
    )
    port: int = Field(
        default=ADVERTISING_PORT,
        ge=1,
        le=65535,
        description="UDP port used to find EmotiBits.",
    )
    ppg_rate: Literal[25, 100] = Field(
        default=25,
        description="Pulse samples per second: 100 with the firmware of that name.",
    )


class PulseRate:
    """Compares the rate of the pulse with the settings, by the first packets of a connection.

    Parameters
    ----------
    name
        Name of the device in errors.
    nominal_hz
        Rate in the settings.
    """

    def __init__(self, name: str, nominal_hz: int) -> None:
        self._name, self._nominal_hz = name, nominal_hz
        self._number: int | None = None
        self._times_ms: list[int] = []
        self._samples = 0
        self.is_right = False  # Whether the rate in the settings is known to be right.

    def take(self, packets: Iterable[Packet]) -> None:
        """Process received packets.

        Raises
        ------
        ProtocolError
            ``UNSUPPORTED`` if the firmware has a different rate.
        """
        for packet in packets:
            if self._number is not None and packet.number != (self._number + 1) % NUMBERS:
                # A loss in between would look like a lower rate.
                self._times_ms, self._samples = [], 0
            self._number = packet.number
            if packet.tag == Tag.PPG_INFRARED and not self.is_right:
                self._samples += len(packet.payload) if self._times_ms else 0
                self._times_ms.append(packet.time_ms)
                self._compare()

    def _compare(self) -> None:
        packets, span_s = len(self._times_ms) - 1, (self._times_ms[-1] - self._times_ms[0]) / 1000
        if packets < _LEAST_PACKETS or span_s <= 0:
            return
        measured_hz = self._samples / span_s
        self.is_right = abs(measured_hz / self._nominal_hz - 1) < _RATE_TOLERANCE
        if self.is_right or packets < _CERTAIN_PACKETS:
            return
        near = [rate for rate in _RATES if abs(measured_hz / rate - 1) < _RATE_TOLERANCE]
        advice = f"set `ppg_rate = {near[0]}`" if near else "install a firmware that has 25 or 100"
        message = (
            f"{self._name} measures the pulse {near[0] if near else measured_hz:.0f} times per "
            f"second, but its setting `ppg_rate` is {self._nominal_hz}; {advice}"
        )
        raise ProtocolError(ProtocolReason.UNSUPPORTED, message)


class EmotiBitDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`."""

    silence_limit_s = 8.0

    def __init__(
        self, settings: EmotiBitSettings, sink: DeviceSink, emitter: EmotiBitEmitter
    ) -> None:
        self._settings = settings
        self._sink = sink
        self._emitter = emitter
        self._advertising = Advertising(settings.host, settings.port)
        self._link: Link | None = None
        self._rate = PulseRate("EmotiBit", settings.ppg_rate)
        self._device: Address = ("", 0)
        # Data are buffered until the rate of the pulse is known.
        self._early = Early[Arrived](_MOST_EARLY)

    async def connect(self) -> Connected:
        """Find the EmotiBit and wait for its first data; see the protocol class."""
        await self._advertising.open()
        nearby = await self._find()
        self._device = nearby.address
        name = f"EmotiBit {nearby.device}" if nearby.device else f"EmotiBit {nearby.address[0]}"
        ports, tap = self._advertising.ports, self._advertising.tap
        self._link = Link(name, nearby.address[0], ports, tap)
        await self._link.open()
        await connect(self._advertising, self._link, nearby)
        # It may be in a mode in which it sends no data.
        self._link.control(Tag.NORMAL_POWER)
        self._emitter.connected()
        self._rate = PulseRate(name, self._settings.ppg_rate)
        await self._first_data(self._link)
        await self._know_rate(self._link)
        info = DeviceInfo(serial_number=nearby.device)
        return Connected(info, {"ppg": self._settings.ppg_rate}, patience_s=PATIENCE_S)

    async def stream(self) -> None:
        """Emit data received since connecting."""
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
        """Switch data on again, for all streams together; see the protocol class."""
        if self._link is not None:
            self._link.control(Tag.NORMAL_POWER)

    async def close(self) -> None:
        """Emit waiting packets, disconnect the EmotiBit, and close."""
        self._emitter.ended()
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
                    await self._keep(link)
        except TimeoutError as error:
            message = f"{link.name}: it is connected but sends no data; switch it off and on"
            raise ProtocolError(ProtocolReason.NO_REPLY, message) from error

    async def _know_rate(self, link: Link) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(RATE_LIMIT_S):
                while not self._rate.is_right:
                    await self._keep(link)

    async def _keep(self, link: Link) -> None:
        arrived = await link.read()
        self._sink.dropped_bytes += arrived.found.dropped_bytes
        if arrived.found.packets:
            self._early.keep(arrived)
            self._rate.take(arrived.found.packets)

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
            self._rate.take(packets)
            self._emitter.take(packets, arrived.arrival_s)
        for packet in packets:
            if packet.tag == Tag.REQUEST_DATA:
                _answer(link, packet, arrived.address)

    async def _ping(self, link: Link) -> None:
        while True:
            self._advertising.tell(Tag.PING, *link.data_payload, to=self._device)
            await asyncio.sleep(PING_EVERY_S)

    async def _hear(self) -> None:
        """Process the device's answers to pings."""
        while True:
            packet, address = await self._advertising.hear()
            if packet.tag == Tag.PONG and address[0] == self._device[0]:
                self._sink.heard()


def _answer(link: Link, request: Packet, to: Address) -> None:
    """Send the time to an EmotiBit, which writes it to the file on its memory card."""
    now = datetime.now(UTC)
    if Tag.TIMESTAMP_LOCAL in request.payload:
        link.answer(Tag.TIMESTAMP_LOCAL, (now.astimezone().strftime(_LOCAL_TIME),), to)
    if Tag.TIMESTAMP_UTC in request.payload:
        link.answer(Tag.TIMESTAMP_UTC, (now.strftime(_LOCAL_TIME),), to)
    link.answer(Tag.ACK, (str(request.number), Tag.REQUEST_DATA), to)


def _make(settings: DeviceSettings, sink: DeviceSink) -> Callable[[], EmotiBitDriver]:
    """Share one emitter between all connections, to count losses across them."""
    own = own_settings(EmotiBitSettings, settings)
    emitter = EmotiBitEmitter(sink, own.ppg_rate)
    return lambda: EmotiBitDriver(own, sink, emitter)


async def find(configured: Sequence[DeviceSettings]) -> list[Found]:
    """Return the EmotiBits at the addresses in the settings, or in the whole network.

    Raises
    ------
    TransportError
        If this computer has no network.
    """
    places = {_place(each) for each in configured} or {("", ADVERTISING_PORT)}
    return [
        _found(nearby, host, port)
        for host, port in sorted(places)
        for nearby in await _nearby(host, port)
    ]


def _place(settings: DeviceSettings) -> tuple[str, int]:
    values = settings.model_dump()
    return values["host"], values["port"]


async def _nearby(host: str, port: int) -> list[Nearby]:
    advertising = Advertising(host, port)
    try:
        await advertising.open()
        return await advertising.nearby(_LISTEN_S, first=False)
    finally:
        advertising.close()


def _found(nearby: Nearby, host: str, port: int) -> Found:
    unit = nearby.device or nearby.address[0]
    settings: dict[str, str | int | float | bool] = {"unit": unit, "device": nearby.device}
    if host or not nearby.device:
        settings["host"] = nearby.address[0]
    if port != ADVERTISING_PORT:
        settings["port"] = port
    return Found("emotibit", f"EmotiBit {unit}", settings)


IDENTIFIERS = (re.compile(rb",DI,([^,\r\n]+)"),)
DRIVER = DriverEntry(EmotiBitSettings, _make, find=find, identifiers=IDENTIFIERS)
