"""The driver of a Shimmer3 or Shimmer3R: how a connection is made of its settings."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from biosensor_gateway.devices.driver import Connected, DriverEntry, own_settings
from biosensor_gateway.devices.shimmer.declaration import SPEC
from biosensor_gateway.devices.shimmer.driver.connection import Prepared, ShimmerDriver
from biosensor_gateway.devices.shimmer.driver.conversation import Conversation
from biosensor_gateway.devices.shimmer.driver.discovery import recognise
from biosensor_gateway.devices.shimmer.driver.emitter import Measurement, ShimmerEmitter
from biosensor_gateway.devices.shimmer.driver.kind import Kind
from biosensor_gateway.devices.shimmer.driver.settings import Shimmer3Settings
from biosensor_gateway.devices.shimmer.driver.setup import set_up
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.settings.models import DeviceSettings

WAVEFORMS = frozenset(stream.data_name for stream in SPEC.streams if stream.is_regular)


def _connected(measurement: Measurement) -> Connected:
    """Tell of all streams at which rate they would come, and which are off."""
    off = WAVEFORMS - set(measurement.streams)
    if measurement.status_at is None:
        off |= {"quality"}
    return Connected(rates=dict.fromkeys(WAVEFORMS, measurement.rate_hz), silent=off)


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


DRIVER = DriverEntry(Shimmer3Settings, _make, recognise=recognise)
