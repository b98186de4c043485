"""Driver for the Vernier respiration belt."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from pydantic import Field

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.driver import Connected, DriverEntry, by_advertisement, own_settings
from biosensor_gateway.devices.vernier_respiration_belt.driver import protocol
from biosensor_gateway.devices.vernier_respiration_belt.driver.conversation import (
    REPLY_LIMIT_S,
    BeltChannels,
    Conversation,
    choose_channels,
)
from biosensor_gateway.devices.vernier_respiration_belt.driver.emitter import VernierEmitter
from biosensor_gateway.devices.vernier_respiration_belt.driver.protocol import Message, Unknown
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.dialogue import Heard
from biosensor_gateway.transports.nearby import Advertisement

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

WAKING_LIMIT_S = 1.0
RESTART_LIMIT_S = 2.0
STATUS_PERIOD_S = 60.0
PATIENCE_S = 8.0
"""Delayed notifications may arrive together after seconds, and would be mistaken for data after a
restart."""
KIND = "GDX-RB"
ADVICE = "press its button until its Bluetooth light blinks red, and disconnect it from other apps"


class VernierSettings(DeviceSettings):
    """Settings of one respiration belt."""

    device: str = Field(
        default="",
        description="Bluetooth address of the belt, as scan shows it, or its serial number, which "
        "is at the end of its Bluetooth name; if empty, the only belt in range.",
        examples=["0K2002Z5"],
    )
    period_ms: int = Field(
        default=100,
        ge=50,
        le=1000,
        description="Time between two samples in milliseconds; the belt may round it.",
    )


class VernierDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`."""

    # Silent streams are detected much earlier; the status is polled once a minute.
    silence_limit_s = 60.0

    def __init__(
        self, settings: VernierSettings, choice: Choice, sink: DeviceSink, emitter: VernierEmitter
    ) -> None:
        self._period_us = settings.period_ms * 1000
        self._sink = sink
        self._emitter = emitter
        self._link = BleLink(choice, sink.clock)
        self._status: tuple[protocol.Status | None, float] = (None, 0.0)
        self._belt = Conversation(self._link, sink)
        self._channels: BeltChannels | None = None

    async def connect(self) -> Connected:
        """Find, identify and start the belt; see the protocol class."""
        belt = self._belt
        await belt.connect()
        await belt.begin()
        await _wake(belt)
        answer = await belt.query(protocol.GET_STATUS)
        self._status = (protocol.parse_status(answer.payload), answer.arrival_s)
        identity = protocol.parse_device_info((await belt.query(protocol.DEVICE_INFO)).payload)
        channels = await self._ask_channels(belt)
        self._period_us = channels.period_us(self._period_us)
        await belt.order(protocol.set_period(self._period_us))
        self._channels = channels
        await self._start(belt, channels)
        rate = 1e6 / self._period_us
        rates = {"force": rate, "bpm": rate}
        return Connected(_device_info(identity), rates, patience_s=PATIENCE_S)

    async def stream(self) -> None:
        """Emit data received since connecting."""
        self._take_status(*self._status)
        await self._belt.stream(self._take, self._emitter.take_rssi, self._ask_status)

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Restart the belt; see the protocol class."""
        del streams
        belt, channels = self._belt, self._channels
        if channels is None:
            raise RuntimeError("a driver streams after it has connected")
        self._emitter.ended()
        try:
            await belt.query(protocol.STOP, RESTART_LIMIT_S)
            await self._start(belt, channels, RESTART_LIMIT_S)
        except ProtocolError as error:
            message = f"{self._link.what} is connected but measures nothing; press its button"
            raise TransportError(TransportReason.SILENT, message) from error

    async def close(self) -> None:
        """Stop the belt without waiting for replies, and disconnect."""
        self._emitter.ended()
        await self._belt.close(self._say_goodbye)

    async def _say_goodbye(self) -> None:
        await self._belt.tell(protocol.STOP)
        await self._belt.tell(protocol.DISCONNECT)

    async def _ask_channels(self, belt: Conversation) -> BeltChannels:
        mask = protocol.parse_mask((await belt.query(protocol.AVAILABLE_CHANNELS)).payload)
        answers = [
            await belt.query(protocol.sensor_info(number))
            for number in protocol.channels_of(mask or 0)
        ]
        channels = [protocol.parse_channel(answer.payload) for answer in answers]
        return choose_channels([channel for channel in channels if channel is not None])

    async def _start(
        self, belt: Conversation, channels: BeltChannels, limit_s: float = REPLY_LIMIT_S
    ) -> None:
        # Before the command, because samples may arrive before its reply.
        self._emitter.started(channels, self._period_us / 1e6)
        await belt.order(protocol.start(channels.mask), limit_s)

    def _take(self, found: Sequence[Heard[Message]]) -> None:
        for message, arrival_s in found:
            if not isinstance(message, Unknown):
                self._sink.heard()
            self._emitter.take(message, arrival_s)

    async def _ask_status(self) -> None:
        while True:
            await asyncio.sleep(STATUS_PERIOD_S)
            try:
                answer = await self._belt.query(protocol.GET_STATUS)
            except ProtocolError as error:
                # The measurement may continue anyway.
                self._emitter.log.warning(str(error))
            else:
                self._take_status(protocol.parse_status(answer.payload), answer.arrival_s)

    def _take_status(self, status: protocol.Status | None, arrival_s: float) -> None:
        if status is not None:
            self._emitter.take_status(status, arrival_s)


async def _wake(belt: Conversation) -> None:
    """Send the first command, twice if needed, because a waking belt misses the first one."""
    try:
        await belt.order(protocol.INIT, WAKING_LIMIT_S)
    except ProtocolError as error:
        if error.reason is not ProtocolReason.NO_REPLY:
            raise
        await belt.order(protocol.INIT)


def _device_info(identity: protocol.Identity | None) -> DeviceInfo:
    if identity is None:
        return DeviceInfo()
    return DeviceInfo("", identity.order_code, identity.serial_number, identity.firmware)


def _make(settings: DeviceSettings, sink: DeviceSink) -> Callable[[], VernierDriver]:
    """Share the emitter and the device selection between all connections."""
    own = own_settings(VernierSettings, settings)
    choice = Choice(identify, KIND, own.device, ADVICE)
    emitter = VernierEmitter(sink)
    return lambda: VernierDriver(own, choice, sink, emitter)


def identify(seen: Advertisement) -> str | None:
    """Return a belt's serial number from the name ``GDX-RB <serial>``; None for other devices."""
    model, _, serial = seen.name.partition(" ")
    return serial.strip() if model == KIND else None


recognise = by_advertisement("vernier_respiration_belt", identify)
# The address in the answer with the device information, after order code, serial number, name and
# date of manufacture.
IDENTIFIERS = (re.compile(rb"GDX-RB\0{10}.{16}.{32}.{14}(?P<address>.{6})", re.DOTALL),)
DRIVER = DriverEntry(VernierSettings, _make, recognise=recognise, identifiers=IDENTIFIERS)
