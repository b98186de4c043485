"""What each packet of a Shimmer puts into which stream, and what it does not."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from biosensor_common.refusal import Refusal
from biosensor_gateway.devices.shimmer.driver import Measurement, ShimmerEmitter
from biosensor_gateway.devices.shimmer.driver.calibration import Exg, Kinematic, Use, registers_for
from biosensor_gateway.devices.shimmer.driver.channels import Layout
from biosensor_gateway.devices.shimmer.driver.messages import BatteryReading, Charging, Packet
from biosensor_gateway.devices.shimmer.driver.packets import Placed, TickTimeline
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


@pytest.mark.parametrize(
    ("rate_hz", "setting"),
    [(51.2, 0), (124.9, 0), (125.0, 1), (128.0, 1), (250.0, 2), (512.0, 3), (4096.0, 6), (9e9, 6)],
)
def test_the_exg_chips_are_set_to_the_next_higher_rate(rate_hz: float, setting: int) -> None:
    chips = registers_for(Use.EMG, 12, rate_hz, lead_off=False)
    assert [chip[0] & 0x7 for chip in chips] == [setting, setting]


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


def test_a_packet_that_came_twice_is_said_to_be_left_out(sink: EmitterSink) -> None:
    emitter = measuring(sink)
    emitter.take([packet(0), packet(1), packet(1), packet(2)])
    assert sink.times["ecg"] == [0, PERIOD_S, 2 * PERIOD_S]
    assert sink.losses == {}
    assert sink.refusals.count(Refusal.LEFT_OUT) == len(
        ("acc_low_noise", "ecg", "pressure", "temp")
    )


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


# Device time and lost samples from a counter of 24 bits.

APART_S = DIVISOR / 32768
TURN = 1 << 24
TURN_S = 512.0


def started(divisor: int = DIVISOR) -> TickTimeline:
    timeline = TickTimeline()
    timeline.started(divisor)
    return timeline


def place(timeline: TickTimeline, ticks: int, arrival_s: float) -> Placed:
    placed = timeline.place(ticks % TURN, arrival_s)
    assert placed is not None
    return placed


def test_steady_packets_have_their_own_times_and_no_loss() -> None:
    timeline = started()
    first = TURN - 3 * DIVISOR
    placed = [place(timeline, first + k * DIVISOR, 100 + k * APART_S) for k in range(8)]
    assert [each.time_s for each in placed] == [first / 32768 + k * APART_S for k in range(8)]
    assert [each.lost for each in placed] == [0] * 8


@given(
    first=st.integers(0, TURN - 1),
    missing=st.integers(0, 3_000_000),
    early_s=st.floats(-9.0, 9.0),
    divisor=st.sampled_from([32, 65, 256, 640]),
)
def test_a_gap_of_any_length_is_counted(
    first: int, missing: int, early_s: float, divisor: int
) -> None:
    timeline = started(divisor)
    place(timeline, first, 1000.0)
    gap_s = (missing + 1) * divisor / 32768
    placed = place(timeline, first + (missing + 1) * divisor, 1000.0 + max(0.0, gap_s + early_s))
    assert placed == Placed(first / 32768 + gap_s, missing)


@given(first=st.integers(0, TURN - 1), gap_s=st.floats(0.5, 5000.0), late_s=st.floats(-0.9, 0.9))
def test_a_counter_that_survives_a_connection_goes_on_without_a_loss(
    first: int, gap_s: float, late_s: float
) -> None:
    timeline = started()
    place(timeline, first, 1000.0)
    timeline.started(DIVISOR)
    step = max(1, round(gap_s * 32768))
    placed = place(timeline, first + step, 1000.0 + gap_s + late_s)
    # Nothing was measured in between.
    assert placed == Placed((first + step) / 32768, 0)


@given(
    first=st.integers(0, TURN - 1),
    gap_s=st.floats(0.5, 5000.0),
    off_s=st.floats(2.0, 510.0),
)
def test_a_restarted_counter_is_told_and_nothing_counts_as_lost(
    first: int, gap_s: float, off_s: float
) -> None:
    timeline = started()
    before = place(timeline, first, 1000.0)
    timeline.started(DIVISOR)
    restarted = first + round((gap_s + off_s) * 32768)
    placed = place(timeline, restarted, 1000.0 + gap_s)
    assert placed.restarted
    assert placed.lost == 0
    assert before.time_s < placed.time_s < before.time_s + gap_s + TURN_S + 1
    following = place(timeline, restarted + 3 * DIVISOR, 1000.0 + gap_s + 3 * APART_S)
    assert following == Placed(placed.time_s + 3 * APART_S, 2)


def test_a_repeated_packet_is_left_out() -> None:
    timeline = started()
    place(timeline, 500, 10.0)
    assert timeline.place(500, 10.0) is None
    assert place(timeline, 500 + DIVISOR, 10.0).lost == 0


def test_a_late_burst_is_no_restart_and_no_loss() -> None:
    timeline = started()
    place(timeline, 500, 10.0)
    placed = [place(timeline, 500 + k * DIVISOR, 16.0) for k in range(1, 5)]
    assert [(each.lost, each.restarted) for each in placed] == [(0, False)] * 4


@given(st.lists(st.tuples(st.integers(0, TURN - 1), st.floats(0, 600)), max_size=60))
def test_whatever_comes_time_goes_on(packets: list[tuple[int, float]]) -> None:
    timeline, arrival_s, times = started(), 0.0, list[float]()
    for ticks, pause_s in packets:
        arrival_s += pause_s
        placed = timeline.place(ticks, arrival_s)
        if placed is not None:
            assert placed.lost >= 0
            times.append(placed.time_s)
    assert all(a < b for a, b in pairwise(times))


@pytest.mark.parametrize("divisor", [65, 256])
def test_jitter_of_the_stamp_is_no_loss(divisor: int) -> None:
    timeline = started(divisor)
    placed = [place(timeline, 1000 + k * divisor + k % 3, 10 + k * divisor / 32768)
              for k in range(100)]  # fmt: skip
    assert {each.lost for each in placed} == {0}
