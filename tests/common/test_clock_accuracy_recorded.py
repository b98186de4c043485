"""A device clock on 150 s of a real BioHarness: its packets, and when a computer read them.

True times are not known. The stamps are compared with a straight line that is found in
hindsight, the highest one under all packets, so the constant delay is in both.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from biosensor_common.device_clock import DeviceClock
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.devices.zephyr.driver.emitter import ZephyrEmitter
from biosensor_gateway.devices.zephyr.driver.protocol import ZephyrProtocol
from biosensor_gateway.devices.zephyr.simulator.recording import RECORDING_150_S, read_timing
from biosensor_gateway.streaming.sink import DeviceSink

SETTLED_S = 10.0

Floats = NDArray[np.float64]


class ObservingSink(DeviceSink):
    """Notes what the device's clock would observe; samples go nowhere."""

    def __init__(self) -> None:
        super().__init__(DeviceIdentity("zephyr", "recorded"), declaration("zephyr"))
        self.packets: list[tuple[float, float]] = []

    def observe(self, device_s: float, arrival_s: float) -> None:
        self.packets.append((device_s, arrival_s))

    def emit(self, data_name: str, samples: ArrayLike, device_times: Sequence[float]) -> None:
        pass


@pytest.fixture(scope="module")
def packets() -> Floats:
    """Return device time and arrival of each packet's last sample, shape (n, 2), seconds."""
    folder = files("biosensor_gateway").joinpath("devices/zephyr/simulator/recordings")
    data = folder.joinpath(f"{RECORDING_150_S}.dat").read_bytes()
    timing = folder.joinpath(f"{RECORDING_150_S}-timing.csv").read_text("ascii")
    sink, protocol = ObservingSink(), ZephyrProtocol()
    emitter, begin = ZephyrEmitter(sink), 0
    for read in read_timing(timing):
        for message in protocol.feed(data[begin : read.total_bytes]):
            emitter.take(message, read.time)
        begin = read.total_bytes
    return np.array(sink.packets)


def _line_in_hindsight(device_s: Floats, arrival_s: Floats) -> Floats:
    """Return the arrival that each packet would have had with the smallest delay."""
    middle_s = float(device_s.mean())
    slopes = np.arange(-250e-6, 250e-6, 1e-6)
    behind_s = arrival_s - device_s
    heights_s = np.array([(behind_s - slope * (device_s - middle_s)).min() for slope in slopes])
    best = int(heights_s.argmax())
    line_s: Floats = device_s + heights_s[best] + slopes[best] * (device_s - middle_s)
    return line_s


def test_stamps_of_a_real_device_keep_within_milliseconds_of_one_line(packets: Floats) -> None:
    device_s, arrival_s = packets.T
    line_s = _line_in_hindsight(device_s, arrival_s)
    clock = DeviceClock()
    stamps_s: list[float] = []
    for device, arrival in packets.tolist():
        assert clock.observe(device, arrival) is None
        stamps_s.append(clock.to_lsl(device))
    settled = arrival_s > arrival_s[0] + SETTLED_S

    delays_ms = 1e3 * (arrival_s - line_s)[settled]
    errors_ms = 1e3 * (np.array(stamps_s) - line_s)[settled]
    p50, p95, p99 = np.percentile(delays_ms, [50, 95, 99])
    print(
        f"\n{settled.sum()} packets, {1e3 * clock.state.residual_rms_s:.0f} ms RMS from the line:"
        f" delay beyond the least p50 {p50:.0f}, p95 {p95:.0f},"
        f" p99 {p99:.0f}, max {delays_ms.max():.0f}, SD {delays_ms.std():.0f} ms; stamps off by"
        f" {errors_ms.mean():.1f} ms, SD {errors_ms.std():.1f}, max {np.abs(errors_ms).max():.1f}"
    )
    # The radio does delay, or nothing is shown.
    assert delays_ms.std() > 50.0
    assert errors_ms.std() < 5.0
    assert np.abs(errors_ms).max() < 15.0
