"""The conversation with a Shimmer3 GSR+: set it up, start it, pass on what it measures."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Literal

import structlog
from pydantic import Field

from biosensor_common.errors import TransportError, TransportReason
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.driver import Connected, DriverEntry, own_settings
from biosensor_gateway.devices.shimmer3_gsr.declaration import SPEC
from biosensor_gateway.devices.shimmer3_gsr.driver import commands
from biosensor_gateway.devices.shimmer3_gsr.driver.conversation import Conversation
from biosensor_gateway.devices.shimmer3_gsr.driver.discovery import recognise
from biosensor_gateway.devices.shimmer3_gsr.driver.emitter import (
    WAVEFORMS,
    Measurement,
    ShimmerEmitter,
)
from biosensor_gateway.devices.shimmer3_gsr.driver.messages import (
    BatteryReading,
    Hardware,
    Packet,
    Stamped,
    Status,
    StatusFlag,
)
from biosensor_gateway.devices.shimmer3_gsr.driver.setup import Kind, Wanted, identify, set_up
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.byte_links import byte_link

BATTERY_PERIOD_S = 60.0
"""The firmware itself looks once a minute."""
PATIENCE_S = 2.0

_log = structlog.get_logger("biosensor_gateway.shimmer3_gsr")


class ShimmerSettings(DeviceSettings):
    """Settings of one Shimmer3 GSR+."""

    port: str = Field(
        min_length=1,
        description="Serial port of the paired Shimmer, COM7 or /dev/rfcomm0 for instance, or its "
        "Bluetooth address, 00:06:66:AA:BB:CC for instance, or socket://HOST:NUMBER.",
        examples=["/dev/rfcomm0"],
    )
    rate_hz: float = Field(
        default=128.0,
        ge=51.2,
        le=1024.0,
        description="Sampling rate in Hz; the device takes the nearest rate that divides 32768.",
    )
    gsr_range: Literal["auto", 0, 1, 2, 3] = Field(
        default="auto",
        description="Range of the skin conductance: auto, or fixed to 0 (15.9 to 125 microsiemens),"
        " 1 (4.5 to 15.9), 2 (1.5 to 4.5) or 3 (0.2 to 1.5).",
    )


class ShimmerDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`."""

    # Silent streams are noticed long before.
    silence_limit_s = 10.0

    def __init__(self, settings: ShimmerSettings, sink: Sink, emitter: ShimmerEmitter) -> None:
        self._port = settings.port
        self._wanted = _wanted(settings)
        self._talk = Conversation(settings.port, byte_link(settings.port))
        self._sink = sink
        self._emitter = emitter
        self._dropped_bytes = 0
        self._measurement: Measurement | None = None
        self._is_docked: bool | None = None
        self._kind: Kind | None = None

    async def connect(self) -> Connected:
        """Open the link, set the device up and start it; see the protocol class."""
        streamed_until_s = await self._talk.open()
        if streamed_until_s is not None:
            self._emitter.kept_measuring_until(streamed_until_s)
        self._kind = await identify(self._talk, self._port)
        measurement = await set_up(self._talk, self._kind, self._wanted, self._port)
        self._measurement = measurement
        self._emitter.started(measurement)
        await self._talk.start_streaming(measurement.layout, measurement.divisor)
        rates = {
            name: measurement.rate_hz
            for name in WAVEFORMS
            if measurement.rate_hz != SPEC.stream(name).rate
        }
        info = DeviceInfo(firmware_version=str(self._kind.firmware))
        return Connected(info, rates, patience_s=PATIENCE_S)

    async def stream(self) -> None:
        """Emit what came while connecting, then all that comes."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._talk.stream(self._hear))
            tasks.create_task(self._ask_for_the_battery())

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Start a device again that answers and sends no data; see the protocol class."""
        del streams
        assert self._measurement is not None
        is_there = await self._is_there()
        if not self._sink.is_waiting:
            return  # data came before the answer
        # As far as one knows it went on measuring.
        self._emitter.kept_measuring_until(self._sink.clock())
        if not is_there:
            message = f"{self._port}: the device has fallen silent; it is started anew"
            raise TransportError(TransportReason.SILENT, message)
        self._emitter.started(self._measurement)
        await self._talk.start_streaming(self._measurement.layout, self._measurement.divisor)

    async def close(self) -> None:
        """Stop the device, without waiting for its answer."""
        self._count_dropped()
        await self._talk.close()

    def _hear(self, found: Sequence[Stamped]) -> None:
        self._count_dropped()
        packets: list[tuple[Packet, float]] = []
        for message, arrival_s in found:
            match message:
                case Packet():
                    packets.append((message, arrival_s))
                case BatteryReading():
                    self._emitter.battery(message, arrival_s)
                case Status():
                    self._note(message)
                case _:
                    pass
        if packets:
            self._sink.heard()
            self._emitter.take(packets)

    def _count_dropped(self) -> None:
        dropped = self._talk.dropped_bytes
        self._sink.dropped_bytes += dropped - self._dropped_bytes
        self._dropped_bytes = dropped

    def _note(self, status: Status) -> None:
        is_docked = StatusFlag.DOCKED in status.flags
        if is_docked != self._is_docked:
            self._is_docked = is_docked
            _log.info("docked" if is_docked else "not docked", port=self._port)

    async def _is_there(self) -> bool:
        assert self._kind is not None
        if self._kind.has_status:
            return await self._talk.poll(commands.GET_STATUS, Status) is not None
        return await self._talk.poll(commands.GET_HARDWARE, Hardware) is not None

    async def _ask_for_the_battery(self) -> None:
        assert self._kind is not None
        while self._kind.has_status:
            await asyncio.sleep(BATTERY_PERIOD_S)
            await self._talk.poll(commands.GET_BATTERY, BatteryReading)


def _wanted(settings: ShimmerSettings) -> Wanted:
    setting = commands.AUTO_RANGE if settings.gsr_range == "auto" else settings.gsr_range
    return Wanted(commands.divisor_for(settings.rate_hz), setting)


def _make(settings: DeviceSettings, sink: Sink) -> Callable[[], ShimmerDriver]:
    """Share one emitter between all connections: it follows the device's clock across them."""
    own = own_settings(ShimmerSettings, settings)
    emitter = ShimmerEmitter(sink)
    return lambda: ShimmerDriver(own, sink, emitter)


DRIVER = DriverEntry(ShimmerSettings, _make, recognise=recognise)
