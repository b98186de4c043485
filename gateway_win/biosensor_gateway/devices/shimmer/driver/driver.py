"""The driver of a Shimmer3 or Shimmer3R: how a connection is made of its settings."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from typing import Literal

from pydantic import Field, field_validator

from biosensor_gateway.devices.discovery import Found
from biosensor_gateway.devices.driver import Connected, DriverEntry, own_settings
from biosensor_gateway.devices.shimmer.declaration import SPEC
from biosensor_gateway.devices.shimmer.driver.commands import divisor_for
from biosensor_gateway.devices.shimmer.driver.connection import Prepared, ShimmerDriver
from biosensor_gateway.devices.shimmer.driver.conversation import Conversation
from biosensor_gateway.devices.shimmer.driver.emitter import Measurement, ShimmerEmitter
from biosensor_gateway.devices.shimmer.driver.exg import Use
from biosensor_gateway.devices.shimmer.driver.kind import Kind
from biosensor_gateway.devices.shimmer.driver.setup import Wanted, set_up
from biosensor_gateway.devices.shimmer.driver.signals import SENSORS
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

WAVEFORMS = frozenset(stream.data_name for stream in SPEC.streams if stream.is_regular)

AS_IT_IS = "device"
SLOWEST_HZ, FASTEST_HZ = 1.0, 2048.0
_NAME = re.compile(r"Shimmer3R?-([0-9A-Fa-f]{4})(?:-BT)?")


class Shimmer3Settings(DeviceSettings):
    """Settings of one Shimmer3 or Shimmer3R."""

    port: str = Field(
        min_length=1,
        description="Serial port of the paired Shimmer, COM7 or /dev/rfcomm0 for instance, or its "
        "Bluetooth address, 00:06:66:AA:BB:CC for instance, or socket://HOST:NUMBER.",
        examples=["/dev/rfcomm0"],
    )
    sensors: str = Field(
        default=AS_IT_IS,
        max_length=100,
        description="Which sensors are on: device for those that the Shimmer was set up with, or "
        f"names with commas between them, of {', '.join(SENSORS)}; ecg and emg exclude each other.",
    )
    rate_hz: float = Field(
        default=0.0,
        ge=0.0,
        le=FASTEST_HZ,
        description="Sampling rate of all sensors in Hz, 1 to 2048, of which the device takes the "
        "nearest that divides 32768; 0 leaves the one that the Shimmer was set up with.",
    )
    exg_bits: Literal[16, 24] = Field(
        default=24, description="Resolution of the ecg or emg that sensors names."
    )
    exg_gain: Literal["usual", 1, 2, 3, 4, 6, 8, 12] = Field(
        default="usual",
        description="Amplification of the ecg or emg that sensors names; the usual is 4 for ecg "
        "and 12 for emg.",
    )
    lead_off: bool = Field(
        default=False,
        description="Whether the ecg that sensors names tells of electrodes that came off; for "
        "that a current of 22 nA flows through them.",
    )

    @field_validator("sensors")
    @classmethod
    def _known(cls, text: str) -> str:
        if text == AS_IT_IS:
            return text
        names = _names(text)
        for name in names:
            if name not in SENSORS:
                known = ", ".join(SENSORS)
                raise ValueError(f"should be {AS_IT_IS}, or of {known}, but has {name!r}")
        if names >= set(Use):
            raise ValueError("should have ecg or emg, which need the same chips, but has both")
        return text

    @field_validator("rate_hz")
    @classmethod
    def _possible(cls, rate_hz: float) -> float:
        if 0 < rate_hz < SLOWEST_HZ:
            raise ValueError("should be 0, or from 1 to 2048")
        return rate_hz

    @property
    def wanted(self) -> Wanted:
        """How to measure."""
        return Wanted(
            None if self.sensors == AS_IT_IS else _names(self.sensors),
            divisor_for(self.rate_hz) if self.rate_hz else None,
            self.exg_bits,
            None if self.exg_gain == "usual" else self.exg_gain,
            self.lead_off,
        )


def _names(text: str) -> frozenset[str]:
    return frozenset(name.strip() for name in text.split(","))


def _connected(measurement: Measurement) -> Connected:
    """Tell of all streams at which rate they would come, and which are off."""
    off = WAVEFORMS - set(measurement.streams)
    if measurement.status_at is None:
        off |= {"quality"}
    rates = dict.fromkeys(WAVEFORMS, measurement.rate_hz)
    return Connected(rates=rates, silent=off, denied=measurement.denied)


def _make(settings: DeviceSettings, sink: Sink) -> Callable[[], ShimmerDriver]:
    """Share one emitter between all connections: it follows the device's clock across them."""
    own = own_settings(Shimmer3Settings, settings)
    emitter = ShimmerEmitter(sink)

    async def prepare(talk: Conversation, kind: Kind) -> Prepared:
        measurement = await set_up(talk, kind, own.wanted, own.port)
        begin = partial(emitter.started, measurement)
        known = _connected(measurement)
        return Prepared(measurement.layout, measurement.divisor, begin, known)

    return lambda: ShimmerDriver(own.port, sink, emitter, prepare)


def recognise(seen: Advertisement | SerialPort) -> Found | None:
    """Return how to add a paired Shimmer; its unit is the number on the case."""
    if not isinstance(seen, SerialPort):
        return None
    name = _NAME.fullmatch(seen.remote_name)
    if name is None:
        return None
    settings = {"unit": name[1].upper(), "port": seen.port}
    return Found("shimmer", seen.remote_name, settings)


DRIVER = DriverEntry(Shimmer3Settings, _make, recognise=recognise)
