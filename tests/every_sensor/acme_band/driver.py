"""The conversation with an Acme Band."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import Field

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.driver import Connected, DriverEntry, Found
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.byte_links import byte_link
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

from .declaration import RATE_HZ
from .protocol import START, STOP, AcmeProtocol, Sample

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

_ANSWER_LIMIT_S = 3.0
_NUMBERS = 2**16


class AcmeSettings(DeviceSettings):
    """Settings of one band."""

    port: str = Field(
        min_length=1, description="Serial port of the Acme Band.", examples=["/dev/ttyACM0"]
    )


class AcmeEmitter:
    """Passes on what a band measures, over all its connections."""

    def __init__(self, sink: DeviceSink) -> None:
        self._sink = sink
        self._count: int | None = None
        self._states: dict[str, float] = {}

    def take(self, sample: Sample, arrival: float) -> None:
        """Emit one sample, and count those that are missing before it."""
        if self._count is None:
            self._count = sample.number
        else:
            step = (sample.number - self._count) % _NUMBERS
            self._count += step
            self._sink.lost("force", step - 1)
        device_s = self._count / RATE_HZ
        self._sink.observe(device_s, arrival)
        self._sink.emit("force", [sample.force_n], [device_s])
        for name, value in (("quality", float(sample.worn)), ("bat", sample.battery_percent)):
            if self._states.get(name) != value:
                self._states[name] = value
                self._sink.emit_value(name, value, device_s)


class AcmeDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`."""

    silence_limit_s = 5.0

    def __init__(self, settings: AcmeSettings, sink: DeviceSink, emitter: AcmeEmitter) -> None:
        self._port = settings.port
        self._link = byte_link(settings.port)
        self._sink = sink
        self._emitter = emitter
        self._protocol = AcmeProtocol()
        self._early: list[tuple[Sample, float]] = []

    async def connect(self) -> Connected:
        """Start the band and wait for its first sample."""
        await self._link.open()
        self._link.write(START)
        try:
            async with asyncio.timeout(_ANSWER_LIMIT_S):
                while not self._early:
                    self._early = await self._read()
        except TimeoutError as error:
            message = f"{self._port}: the band does not answer; switch it off and on"
            raise ProtocolError(ProtocolReason.NO_REPLY, message) from error
        return Connected(DeviceInfo(manufacturer="Acme", model="Band"))

    async def stream(self) -> None:
        """Emit what came while connecting, then all that comes."""
        while True:
            for sample, arrival in self._early:
                self._emitter.take(sample, arrival)
            self._early = await self._read()

    async def close(self) -> None:
        """Stop the band."""
        self._link.write(STOP)
        await self._link.close()

    async def _read(self) -> list[tuple[Sample, float]]:
        data, arrival = await self._link.read()
        dropped = self._protocol.dropped_bytes
        samples = self._protocol.feed(data)
        self._sink.dropped_bytes += self._protocol.dropped_bytes - dropped
        return [(sample, arrival) for sample in samples]


def _recognise(seen: Advertisement | SerialPort) -> Found | None:
    if isinstance(seen, SerialPort) and seen.remote_name.startswith("AcmeBand-"):
        unit = seen.remote_name.removeprefix("AcmeBand-")
        return Found("acme_band", seen.remote_name, {"unit": unit, "port": seen.port})
    return None


async def _find(configured: Sequence[DeviceSettings]) -> Sequence[Found]:
    ports = [each.port for each in configured if isinstance(each, AcmeSettings)]
    here = [port for port in ports if Path(port).exists()]  # noqa: ASYNC240 - a local name
    return [Found("acme_band", "Acme Band", {"unit": "1", "port": port}) for port in here]


def _make(settings: DeviceSettings, sink: DeviceSink) -> Callable[[], AcmeDriver]:
    if not isinstance(settings, AcmeSettings):
        raise TypeError(f"not the settings of an Acme Band: {type(settings).__name__}")
    emitter = AcmeEmitter(sink)
    return lambda: AcmeDriver(settings, sink, emitter)


DRIVER = DriverEntry(AcmeSettings, _make, recognise=_recognise, find=_find)
