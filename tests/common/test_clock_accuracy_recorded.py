"""A device clock on 150 s of a real BioHarness: its packets, and when a computer read them.

True times are not known. The stamps are compared with a straight line that is found in
hindsight, the highest one under all packets, so the constant delay is in both.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files

import numpy as np
import pytest
from numpy.typing import ArrayLike

from biosensor_common.device_clock import DeviceClock
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.devices.zephyr.driver.emitter import ZephyrEmitter
from biosensor_gateway.devices.zephyr.driver.protocol import ZephyrProtocol
from biosensor_gateway.devices.zephyr.simulator.recording import RECORDING_150_S, read_timing
from biosensor_gateway.streaming.sink import DeviceSink
from tests.rigs.hindsight import Floats, line_in_hindsight

SETTLED_S = 10.0


class ObservingSink(DeviceSink):
    """Notes what the device's clock would observe; samples go nowhere."""

    def __init__(self) -> None:
        super().__init__(DeviceIdentity("zephyr", "recorded"), declaration("zephyr"))
        self.packets: list[tuple[float, float]] = []

    def observe(self, device_s: float, arrival_s: float, kind: str = "") -> None:
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


def test_stamps_of_a_real_device_keep_within_milliseconds_of_one_line(packets: Floats) -> None:
    device_s, arrival_s = packets.T
    line_s = line_in_hindsight(device_s, arrival_s)
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


@pytest.mark.parametrize("begin", range(0, 600, 25))
def test_a_real_radio_is_never_taken_for_a_clock_that_was_set(packets: Floats, begin: int) -> None:
    clock = DeviceClock()
    assert [clock.observe(*packet) for packet in packets[begin:].tolist()] == [None] * (
        len(packets) - begin
    )


@pytest.mark.parametrize("set_back_s", [0.2, 0.307, 0.45])
def test_over_a_real_radio_a_clock_that_was_set_back_is_found_within_seconds(
    packets: Floats, set_back_s: float
) -> None:
    set_at_s = packets[0, 1] + 75.0
    clock = DeviceClock()
    found: list[float] = []
    for device, arrival in packets.tolist():
        is_set = arrival > set_at_s
        if clock.observe(device - set_back_s * is_set, arrival) is not None:
            found.append(arrival - set_at_s)
    device_s = packets[-1, 0]
    line_s = line_in_hindsight(*packets.T)[-1]
    assert [0.0 < after_s < 15.0 for after_s in found] == [True]
    assert abs(clock.to_lsl(device_s - set_back_s) - line_s) < 0.015
