"""A device's sink that checks what an emitter hands over, in place of pushing it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.sink import DeviceSink
from tests.fuzz.contract import ensure

ARRIVAL_S = 5_000.0
"""LSL clock when the first bytes of an input arrive; an emitter must not look at another."""


class CheckedSink(DeviceSink):
    """The real clock, no outlets: samples must have the declared shape, and a time each."""

    def __init__(self, sensor_name: str) -> None:
        super().__init__(DeviceIdentity(sensor_name, "fuzzed"), declaration(sensor_name))
        self._streams = {stream.data_name: stream for stream in declaration(sensor_name).streams}

    def emit_at(self, data_name: str, samples: ArrayLike, lsl_times: Sequence[float]) -> None:
        stream = self._streams[data_name]
        values = np.asarray(samples, np.float64)
        values = values[:, np.newaxis] if values.ndim == 1 else values
        shape = (len(lsl_times), len(stream.channels))
        ensure(values.shape == shape, f"{data_name} has another shape", values.shape, shape)
        ensure(all(map(math.isfinite, lsl_times)), f"{data_name} has no time", list(lsl_times))

    def emit_text(self, data_name: str, text: str, device_s: float) -> None:
        ensure(data_name in self._streams, "there is no such stream", data_name)
        ensure(math.isfinite(device_s), f"{data_name} has no time", text, device_s)

    def lost(self, data_name: str, count: int) -> None:
        ensure(data_name in self._streams, "there is no such stream", data_name)
        ensure(count >= 0, f"a negative number of samples of {data_name} is lost", count)
