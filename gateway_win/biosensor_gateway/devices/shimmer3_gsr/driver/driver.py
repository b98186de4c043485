"""The driver of a Shimmer3 GSR+: its settings, and how a connection is made of them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Literal

from pydantic import Field

from biosensor_gateway.devices.driver import Connected, DriverEntry, own_settings
from biosensor_gateway.devices.shimmer.driver import commands
from biosensor_gateway.devices.shimmer.driver.connection import Prepared, ShimmerDriver
from biosensor_gateway.devices.shimmer.driver.conversation import Conversation
from biosensor_gateway.devices.shimmer.driver.kind import Kind
from biosensor_gateway.devices.shimmer3_gsr.declaration import SPEC
from biosensor_gateway.devices.shimmer3_gsr.driver.discovery import recognise
from biosensor_gateway.devices.shimmer3_gsr.driver.emitter import WAVEFORMS, GsrEmitter
from biosensor_gateway.devices.shimmer3_gsr.driver.setup import Wanted, set_up
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.settings.models import DeviceSettings


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


def _wanted(settings: ShimmerSettings) -> Wanted:
    setting = commands.AUTO_RANGE if settings.gsr_range == "auto" else settings.gsr_range
    return Wanted(commands.divisor_for(settings.rate_hz), setting)


def _make(settings: DeviceSettings, sink: Sink) -> Callable[[], ShimmerDriver]:
    """Share one emitter between all connections: it follows the device's clock across them."""
    own = own_settings(ShimmerSettings, settings)
    emitter = GsrEmitter(sink)
    wanted = _wanted(own)

    async def prepare(talk: Conversation, kind: Kind) -> Prepared:
        measurement = await set_up(talk, kind, wanted, own.port)
        rates = {
            name: measurement.rate_hz
            for name in WAVEFORMS
            if measurement.rate_hz != SPEC.stream(name).rate
        }
        begin = partial(emitter.started, measurement)
        return Prepared(measurement.layout, measurement.divisor, begin, Connected(rates=rates))

    return lambda: ShimmerDriver(own.port, sink, emitter, prepare)


DRIVER = DriverEntry(ShimmerSettings, _make, recognise=recognise)
