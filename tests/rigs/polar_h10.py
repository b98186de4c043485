"""A virtual Polar sensor, as plain bleak reads it and held against what it measured."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.system.clock import LSL_CLOCK
from tests.rigs.driver_run import NotedSink
from tests.rigs.gatt_host import GattHost
from tests.rigs.truth import assert_once_and_in_order

# What came from a virtual Polar sensor, held against what it measured.

_NEAR_S = 0.5
# In real time, a packet that begins a connection may be held up by whatever else the machine does.
_LATEST_S = 3.0


def assert_only_gaps(h10: SimulatedPolarH10, sink: NotedSink) -> None:
    """Assert that what arrived was sent, came once and in order, and is stamped about right."""
    for name in ("ecg", "acc"):
        truth = h10.truth.samples(name)
        places = assert_once_and_in_order(sink.rows[name], truth.values)
        times = np.array(sink.times[name])
        assert np.all(np.diff(times) > 0)
        errors = times - truth.times[places]
        assert np.min(errors, initial=0.0) > -_NEAR_S
        latest_s = _LATEST_S if h10.world.clock is LSL_CLOCK else _NEAR_S
        assert np.max(errors, initial=0.0) < latest_s


# The measurement data of a Polar sensor, as plain bleak and a small decoder of its own see it.
HEART_RATE = "2a37"
CONTROL = "fb005c81-02e7-f387-1cad-8acd2d8df0c8"
DATA = "fb005c82-02e7-f387-1cad-8acd2d8df0c8"
NAME = "Polar H10 A1B2C3D4"
START_ECG = "020000018200 01010e00"
START_ACC = "02020201080000 01c80001011000"


class Frame(NamedTuple):
    """One frame: the kind of measurement, the time of its last sample, layout and samples."""

    kind: int
    stamp_ns: int
    layout: int
    body: bytes


def frames_of(host: GattHost, kind: int) -> list[Frame]:
    """Return the frames of one measurement that have come so far."""
    found = [
        Frame(data[0], int.from_bytes(data[1:9], "little"), data[9], data[10:])
        for data in host.all(DATA)
    ]
    return [frame for frame in found if frame.kind == kind]


def int24(body: bytes) -> list[int]:
    """Read signed numbers of three bytes each."""
    return [
        int.from_bytes(body[at : at + 3], "little", signed=True) for at in range(0, len(body), 3)
    ]


async def open_pmd(host: GattHost) -> None:
    """Subscribe to what carries commands and measurements."""
    await host.subscribe(CONTROL, DATA)
