"""What each packet of a Shimmer puts into which stream, and what it does not."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from biosensor_gateway.devices.shimmer.driver.calibration import Kinematic
from biosensor_gateway.devices.shimmer.driver.channels import Layout
from biosensor_gateway.devices.shimmer.driver.emitter import Measurement, ShimmerEmitter
from biosensor_gateway.devices.shimmer.driver.exg import Exg, Use, registers_for
from biosensor_gateway.devices.shimmer.driver.messages import BatteryReading, Charging, Packet
from biosensor_gateway.devices.shimmer.driver.signals import (
    air_signals,
    exg_signal,
    motion_signals,
    status_places,
)
from tests.rigs.emitter_sink import EmitterSink

DIVISOR = 256
PERIOD_S = 1 / 128
ARRIVAL_S = 5000.0
ACCEL = Kinematic.of((100, 0, 0), (1000, 1000, 1000), np.eye(3))
ECG = registers_for(Use.ECG, 4, 128.0, lead_off=True)
UV_PER_COUNT = 2.42e6 / 4 / (2**23 - 1)
ALL_ON = 0x80

Floats = NDArray[np.float64]


@pytest.fixture
def sink() -> EmitterSink:
    return EmitterSink("shimmer")


def measuring(sink: EmitterSink) -> ShimmerEmitter:
    """Acceleration, air and ECG, in an order that no device has."""
    layout = Layout([0x1D, 0x1E, 0x1F, 0x20, 0x21, 0x22, 0x02, 0x01, 0x00, 0x1B, 0x1A])

    def compensate(raw_t: Floats, raw_p: Floats) -> tuple[Floats, Floats]:
        return raw_p * 10, raw_t / 10

    signals = (
        exg_signal(layout, Exg(ECG)),
        *motion_signals(layout, [("acc_low_noise", ACCEL)]),
        *air_signals(layout, compensate),
    )
    emitter = ShimmerEmitter(sink)
    emitter.started(Measurement(layout, DIVISOR, signals, status_places(layout)))
    return emitter


def packet(number: int, *, first: int = ALL_ON, second: int = ALL_ON) -> tuple[Packet, float]:
    values = (first, 1000, 2000, second, 7, -3000, 9807, 0, 100, 10132, 251)
    return Packet(number * DIVISOR, values), ARRIVAL_S + number * PERIOD_S


def test_every_stream_has_its_own_channels_in_units(sink: EmitterSink) -> None:
    emitter = measuring(sink)
    emitter.take([packet(0), packet(1)])
    assert sink.calls == [
        *("observe", "ecg", "acc_low_noise", "pressure", "temp", "quality"),
    ]
    leads = [1000 * UV_PER_COUNT, 2000 * UV_PER_COUNT, -3000 * UV_PER_COUNT]
    np.testing.assert_allclose(sink.emitted["ecg"], [leads] * 2)
    np.testing.assert_allclose(sink.emitted["acc_low_noise"], [[0, 0, 1.00004]] * 2, atol=1e-5)
    assert sink.emitted["pressure"] == [[101320]] * 2
    assert sink.emitted["temp"] == [[25.1]] * 2
    assert sink.times["ecg"] == [0, PERIOD_S]
    assert sink.emitted["quality"] == [[1, 1, 1, 1, 1]]


@pytest.mark.parametrize(
    ("first", "second", "electrodes"),
    [
        (ALL_ON | 2, ALL_ON, [0, 0, 1, 1, 1]),
        (ALL_ON | 4, ALL_ON, [0, 1, 0, 1, 1]),
        (ALL_ON | 1, ALL_ON, [0, 1, 1, 0, 1]),
        (ALL_ON, ALL_ON | 4, [0, 1, 1, 1, 0]),
        (ALL_ON | 7, ALL_ON | 4, [0, 0, 0, 0, 0]),
        # Inputs that no electrode is at.
        (ALL_ON | 0x18, ALL_ON | 0x1B, [1, 1, 1, 1, 1]),
    ],
)
def test_an_electrode_that_came_off_is_told_at_once(
    sink: EmitterSink, first: int, second: int, electrodes: list[float]
) -> None:
    emitter = measuring(sink)
    emitter.take([packet(0), packet(1, first=first, second=second), packet(2)])
    changes = [] if electrodes[0] else [electrodes, [1.0] * 5]
    assert sink.emitted["quality"] == [[1.0] * 5, *changes]
    assert sink.times["quality"] == [0, PERIOD_S, 2 * PERIOD_S][: 1 + len(changes)]


def test_quality_is_told_every_ten_seconds(sink: EmitterSink) -> None:
    emitter = measuring(sink)
    emitter.take([packet(number) for number in range(128 * 31)])
    assert len(sink.emitted["quality"]) == 4


@pytest.mark.parametrize(("unheard_s", "lost"), [(0.4 * PERIOD_S, 0), (PERIOD_S, 1), (1.0, 128)])
def test_what_it_measured_unheard_is_lost(sink: EmitterSink, unheard_s: float, lost: int) -> None:
    emitter = measuring(sink)
    emitter.take([packet(0)])
    emitter.kept_measuring_until(ARRIVAL_S + unheard_s)
    emitter.take([packet(1)])
    assert sink.losses.get("ecg", 0) == lost


def test_a_lost_packet_is_lost_to_all_its_streams(sink: EmitterSink) -> None:
    emitter = measuring(sink)
    emitter.take([packet(0)])
    emitter.take([packet(4)])
    assert sink.losses == dict.fromkeys(("ecg", "acc_low_noise", "pressure", "temp"), 3)


def test_leads_of_a_chip_that_is_off_have_no_value(sink: EmitterSink) -> None:
    layout = Layout([0x1D, 0x23, 0x24])
    signal = exg_signal(layout, Exg(registers_for(Use.ECG, 6, 128.0, lead_off=False)))
    raw = np.array([[0x80, 100.0, 200.0]])
    per_count = 2.42e6 / 12 / 32767
    np.testing.assert_allclose(
        signal.convert(raw[:, signal.at]), [[100 * per_count, 200 * per_count, np.nan]]
    )
    assert status_places(layout) is None
    del sink


def test_a_battery_reading_is_a_percentage(sink: EmitterSink) -> None:
    measuring(sink).battery(BatteryReading(2862, Charging.UNKNOWN), ARRIVAL_S)
    assert sink.emitted["bat"] == [[100]]
    assert sink.lsl_times["bat"] == [ARRIVAL_S]
