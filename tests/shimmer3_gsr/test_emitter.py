"""What each reading of a Shimmer puts into which stream, and beats in a pulse wave."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from structlog.testing import capture_logs

from biosensor_gateway.devices.shimmer.driver.channels import Layout
from biosensor_gateway.devices.shimmer.driver.messages import BatteryReading, Charging, Packet
from biosensor_gateway.devices.shimmer3_gsr.driver import (
    GsrEmitter,
    HeartRate,
    Measurement,
    PulseRate,
)
from biosensor_gateway.simulation.wearer import Wearer
from tests.rigs.emitter_sink import EmitterSink

# What each reading of a Shimmer puts into which stream, and what it does not.

DIVISOR = 256
RATE_HZ = 128.0
PERIOD_S = 1 / RATE_HZ
ARRIVAL_S = 5000.0
AUTO = 4
FINGER_RAW = 0x49C4
FINGER_US = 9.278758407678268
OPEN_RAW = 0xC258
PPG_RAW = 1820
PPG_MV = 1820 * 3000 / 4095
NAN = math.nan


@pytest.fixture
def sink() -> EmitterSink:
    return EmitterSink("shimmer3_gsr")


@pytest.fixture
def emitter(sink: EmitterSink) -> GsrEmitter:
    made = GsrEmitter(sink)
    made.started(Measurement(Layout([0x12, 0x1C]), DIVISOR, AUTO))
    return made


Read = list[tuple[Packet, float]]


def packet(number: int, gsr: int = FINGER_RAW, ppg: int = PPG_RAW, first: int = 0) -> Packet:
    return Packet((first + number * DIVISOR) % (1 << 24), (ppg, gsr))


def read(numbers: Sequence[int], gsr: int = FINGER_RAW, first: int = 0) -> Read:
    arrival_s = ARRIVAL_S + numbers[-1] * PERIOD_S
    return [(packet(number, gsr, first=first), arrival_s) for number in numbers]


def test_samples_are_in_units_and_one_chunk_a_read(emitter: GsrEmitter, sink: EmitterSink) -> None:
    emitter.take(read(range(5)))
    assert sink.calls == ["observe", "gsr", "ppg", "quality"]
    assert sink.emitted["gsr"] == [[pytest.approx(FINGER_US)]] * 5
    assert sink.emitted["ppg"] == [[pytest.approx(PPG_MV)]] * 5
    assert sink.times["gsr"] == sink.times["ppg"] == [number * PERIOD_S for number in range(5)]
    # The clock is told when the last sample was measured, and when that arrived.
    assert sink.observed == [(4 * PERIOD_S, ARRIVAL_S + 4 * PERIOD_S)]
    assert sink.losses == {}


def test_the_order_of_the_channels_is_that_of_the_inquiry(sink: EmitterSink) -> None:
    emitter = GsrEmitter(sink)
    emitter.started(Measurement(Layout([0x1C, 0x03, 0x12]), DIVISOR, AUTO))
    emitter.take([(Packet(0, (FINGER_RAW, 2852, PPG_RAW)), ARRIVAL_S)])
    assert sink.emitted["gsr"] == [[pytest.approx(FINGER_US)]]
    assert sink.emitted["ppg"] == [[pytest.approx(PPG_MV)]]


def test_open_electrodes_are_no_value_and_show_in_quality(
    emitter: GsrEmitter, sink: EmitterSink
) -> None:
    emitter.take(read([0]))
    emitter.take(read([1, 2], OPEN_RAW))
    emitter.take(read([3, 4], OPEN_RAW))
    emitter.take(read([5]))
    values = np.array(sink.emitted["gsr"])[:, 0]
    np.testing.assert_allclose(values, [FINGER_US, NAN, NAN, NAN, NAN, FINGER_US])
    # The other signal does not mind.
    assert sink.emitted["ppg"] == [[pytest.approx(PPG_MV)]] * 6
    assert sink.emitted["quality"] == [[1, 1, 0], [0, 3, 0], [1, 1, 0]]
    assert sink.times["quality"] == [0, 2 * PERIOD_S, 5 * PERIOD_S]


@pytest.mark.parametrize("raw", [0x0000, 0x02AA, 0x4000, 0x82AA, 0xC000, 0xC2AB])
def test_no_current_is_never_0(emitter: GsrEmitter, sink: EmitterSink, raw: int) -> None:
    emitter.take(read([0], raw))
    np.testing.assert_array_equal(sink.emitted["gsr"], [[NAN]])
    assert sink.emitted["quality"][0][0] == 0


@pytest.mark.parametrize("setting", range(4))
def test_a_fixed_range_goes_before_the_bits(sink: EmitterSink, setting: int) -> None:
    emitter = GsrEmitter(sink)
    emitter.started(Measurement(Layout([0x12, 0x1C]), DIVISOR, setting))
    emitter.take(read([0]))
    low_us, high_us = [(15.87, 125), (4.54, 15.88), (1.47, 4.55), (0.21, 1.48)][setting]
    assert low_us <= sink.emitted["gsr"][0][0] <= high_us
    assert sink.emitted["quality"][0][1] == setting


def test_quality_is_told_every_ten_seconds(emitter: GsrEmitter, sink: EmitterSink) -> None:
    for number in range(0, 128 * 31, 8):
        emitter.take(read(range(number, number + 8)))
    assert sink.emitted["quality"] == [[1, 1, 0]] * 4
    assert sink.times["quality"] == pytest.approx([0, 10, 20, 30], abs=0.1)


def pulse(number: int) -> Packet:
    phase = number * PERIOD_S * 75 / 60 % 1.0
    ppg = round(2000 + 80 * math.exp(-0.5 * ((phase - 0.3) / 0.08) ** 2))
    return packet(number, ppg=ppg)


def test_heart_rate_comes_from_the_pulse(emitter: GsrEmitter, sink: EmitterSink) -> None:
    for number in range(0, 128 * 30, 8):
        arrival_s = ARRIVAL_S + (number + 8) * PERIOD_S
        emitter.take([(pulse(each), arrival_s) for each in range(number, number + 8)])
    rates = np.array(sink.emitted["hr"])[:, 0]
    np.testing.assert_allclose(rates[2:], 75, atol=0.5)
    assert len(rates) == pytest.approx(30 * 75 / 60 - 4, abs=2)
    assert np.diff(sink.times["hr"]) == pytest.approx(np.full(len(rates) - 1, 0.8), abs=0.02)
    assert [row[2] for row in sink.emitted["quality"]][:2] == [0, 1]
    quiet = 128 * 30
    for number in range(quiet, quiet + 128 * 4, 8):
        emitter.take(read(range(number, number + 8)))
    assert sink.emitted["quality"][-1] == [1, 1, 0]
    assert sink.times["quality"][-1] == pytest.approx(sink.times["hr"][-1] + 2, abs=0.1)


def test_missing_packets_are_counted(emitter: GsrEmitter, sink: EmitterSink) -> None:
    emitter.take(read([0, 1, 4, 5]))
    emitter.take(read([9]))
    assert sink.losses == {"gsr": 5, "ppg": 5}
    assert sink.times["gsr"] == [number * PERIOD_S for number in (0, 1, 4, 5, 9)]


def test_a_repeated_packet_is_emitted_once(emitter: GsrEmitter, sink: EmitterSink) -> None:
    emitter.take(read([0, 1]))
    emitter.take([(packet(1), ARRIVAL_S + PERIOD_S)])
    emitter.take(read([2]))
    assert sink.times["gsr"] == [0, PERIOD_S, 2 * PERIOD_S]


def again(emitter: GsrEmitter) -> None:
    emitter.started(Measurement(Layout([0x12, 0x1C]), DIVISOR, AUTO))


def test_after_a_reconnection_time_goes_on_and_nothing_is_lost(
    emitter: GsrEmitter, sink: EmitterSink
) -> None:
    emitter.take(read([0]))
    again(emitter)
    emitter.take(read([1000], first=100))
    assert sink.times["gsr"] == [0, pytest.approx(1000 * PERIOD_S + 100 / 32768)]
    assert sink.losses == {}
    assert "restart_clock" not in sink.calls


def test_a_restarted_counter_restarts_the_clock(emitter: GsrEmitter, sink: EmitterSink) -> None:
    emitter.take(read([60_000]))
    again(emitter)
    emitter.take([(packet(number), ARRIVAL_S + 475 + 0.01 * number) for number in (10, 11)])
    assert sink.calls == [
        "observe", "gsr", "ppg", "quality", "restart_clock", "observe", "gsr", "ppg", "quality"
    ]  # fmt: skip
    assert sink.losses == {}
    first, second, third = sink.times["gsr"]
    assert second > first
    assert third - second == PERIOD_S


def test_a_device_that_kept_streaming_lost_what_nobody_heard(
    emitter: GsrEmitter, sink: EmitterSink
) -> None:
    emitter.take(read([0]))
    emitter.kept_measuring_until(ARRIVAL_S + 2.0)
    emitter.kept_measuring_until(ARRIVAL_S + 3.0)
    again(emitter)
    assert sink.losses == {}
    with capture_logs() as logs:
        for number in range(1000, 1100):
            emitter.take(read([number]))
    assert sink.losses == {"gsr": 384, "ppg": 384}
    assert [entry["estimated_samples"] for entry in logs] == [384]


def test_a_device_that_was_switched_off_lost_nothing_that_one_knows_of(
    emitter: GsrEmitter, sink: EmitterSink
) -> None:
    emitter.take(read([60_000]))
    emitter.kept_measuring_until(ARRIVAL_S + 471)
    again(emitter)
    emitter.take([(packet(number), ARRIVAL_S + 475 + 0.01 * number) for number in (10, 11)])
    assert sink.calls.count("restart_clock") == 1
    assert sink.losses == {}


def test_a_device_that_streamed_to_somebody_else_lost_nothing(
    emitter: GsrEmitter, sink: EmitterSink
) -> None:
    emitter.kept_measuring_until(ARRIVAL_S)
    emitter.take(read([0, 1]))
    assert sink.losses == {}


def test_battery_is_stamped_by_arrival(emitter: GsrEmitter, sink: EmitterSink) -> None:
    emitter.battery(BatteryReading(2618, Charging.UNKNOWN), ARRIVAL_S)
    emitter.battery(BatteryReading(3200, Charging.SUSPENDED), ARRIVAL_S + 60)
    assert sink.emitted["bat"] == [[pytest.approx(57.317, abs=1e-3)]]
    assert sink.times["bat"] == [ARRIVAL_S]


def test_the_pulse_of_a_shimmer3r_has_the_scale_of_a_shimmer3(sink: EmitterSink) -> None:
    emitted: list[list[list[float]]] = []
    for is_3r in (False, True):
        emitter = GsrEmitter(sink)
        emitter.started(Measurement(Layout([0x12, 0x1C], is_3r=is_3r), DIVISOR, AUTO))
        for number in range(0, 1280, 8):
            emitter.take([(pulse(each), ARRIVAL_S) for each in range(number, number + 8)])
        emitted.append(sink.emitted.pop("ppg"))
    assert emitted[0] == emitted[1]
    assert np.isfinite(emitted[1]).all()


# Beats in a pulse wave: how exact, and when to say nothing.
Floats = NDArray[np.float64]
RATES_HZ = (51.2, 128.0, 256.0, 512.0)


def clock(seconds: float, rate_hz: float) -> Floats:
    return 7000 + np.arange(int(seconds * rate_hz)) / rate_hz


def wave(times: Floats, bpm: float, noise_mv: float = 0.5) -> Floats:
    """Return a pulse of 40 mV on an offset that drifts."""
    phase = times * bpm / 60 % 1.0
    systole = np.exp(-0.5 * ((phase - 0.18) / 0.08) ** 2)
    dicrotic = 0.35 * np.exp(-0.5 * ((phase - 0.48) / 0.09) ** 2)
    drift = 1500 + 30 * np.sin(2 * np.pi * 0.1 * times)
    noise = np.random.default_rng(1).normal(0, noise_mv, times.size)
    return 40 * (systole + dicrotic) + drift + noise


def detect(detector: PulseRate, times: Floats, values: Floats) -> list[HeartRate]:
    fed = (
        detector.feed(time_s, value)
        for time_s, value in zip(times.tolist(), values.tolist(), strict=True)
    )
    return [rate for rates in fed for rate in rates]


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("bpm", [48, 72, 110, 165])
def test_a_steady_pulse_is_told_within_half_a_beat_a_minute(bpm: float, rate_hz: float) -> None:
    times = clock(60, rate_hz)
    found = detect(PulseRate(rate_hz), times, wave(times, bpm))
    settled = [rate for rate in found if rate.time_s > times[0] + 10]
    assert max(abs(rate.bpm - bpm) for rate in settled) < 0.5
    # One value a beat, once there have been five.
    assert len(found) == pytest.approx(bpm - 4, abs=4)
    assert all(b.time_s - a.time_s == pytest.approx(60 / bpm, abs=0.02) for a, b in pairwise(found))


def test_a_rate_that_breathes_is_followed() -> None:
    wearer = Wearer(seed=3)
    times = clock(120, 128)
    found = detect(PulseRate(128), times, 1500 + 60 * wearer.pulse(times))
    beats = wearer.beats_between(times[0], times[-1])
    errors = [
        rate.bpm - 60 / np.median(wearer.rr_before(beats[beats < rate.time_s - 0.2][-5:]))
        for rate in found[5:]
    ]
    assert np.max(np.abs(errors)) < 1.0


def test_nothing_before_five_beats() -> None:
    times = clock(30, 128)
    values = np.where(times < times[0] + 10, 1500.0, wave(times, 60, 0))
    found = detect(PulseRate(128), times, values)
    assert found[0].time_s - times[0] > 10 + 4


@pytest.mark.parametrize("quiet_mv", [0.0, 0.3])
def test_without_a_pulse_nothing_is_told(quiet_mv: float) -> None:
    times = clock(120, 128)
    noise = np.random.default_rng(5).normal(1500, quiet_mv, times.size)
    detector = PulseRate(128)
    assert detect(detector, times, noise) == []
    assert not detector.found(float(times[-1]))


def test_a_pulse_that_ends_is_missed_after_two_seconds_and_must_show_again() -> None:
    times = clock(60, 128)
    begin = times[0]
    silent = (times >= begin + 20) & (times < begin + 40)
    values = np.where(silent, 1500.0, wave(times, 72, 0))
    detector = PulseRate(128)
    before = times < begin + 20
    last = detect(detector, times[before], values[before])[-1].time_s
    assert detector.found(last + 1.9)
    assert not detector.found(last + 2.1)
    found = [rate.time_s - begin for rate in detect(detector, times[~before], values[~before])]
    assert [time_s for time_s in found if 21 < time_s < 43] == []
    assert found[-1] > 59
    assert detector.found(float(times[-1]))


def test_a_hole_in_the_signal_makes_no_beat_and_no_false_rate() -> None:
    times = clock(60, 128)
    values = wave(times, 90, 0)
    kept = (times < times[0] + 20) | (times > times[0] + 20.4)
    found = detect(PulseRate(128), times[kept], values[kept])
    assert max(abs(rate.bpm - 90) for rate in found if rate.time_s > times[0] + 5) < 1.0
    gap = [rate for rate in found if 20.4 < rate.time_s - times[0] < 20.4 + 4 * 60 / 90]
    assert gap == []


def test_a_few_lost_samples_cost_nothing() -> None:
    times = clock(60, 128)
    values = wave(times, 90, 0)
    kept = np.arange(times.size) % 40 > 2
    found = detect(PulseRate(128), times[kept], values[kept])
    assert max(abs(rate.bpm - 90) for rate in found if rate.time_s > times[0] + 5) < 3.0
    assert len(found) > 75


def test_one_false_beat_does_not_change_the_rate_and_a_new_rate_is_believed_soon() -> None:
    times = clock(60, 128)
    artefact = 120 * np.exp(-0.5 * ((times - times[0] - 20.13) / 0.05) ** 2)
    slow, fast = wave(times, 60, 0), wave(times, 120, 0)
    values = np.where(times < times[0] + 40, slow + artefact, fast)
    found = detect(PulseRate(128), times, values)
    steady = [rate.bpm for rate in found if 10 < rate.time_s - times[0] < 40]
    assert steady == pytest.approx([60.0] * len(steady), abs=3)
    after = [rate.bpm for rate in found if rate.time_s - times[0] > 47]
    assert after == pytest.approx([120.0] * len(after), abs=1)
    assert len(after) > 20


def test_it_is_causal() -> None:
    times = clock(30, 128)
    values = wave(times, 72)
    half = times.size // 2
    whole = detect(PulseRate(128), times, values)
    other = np.concatenate([values[:half], 1500 + 300 * np.sin(times[half:] * 50)])
    changed = detect(PulseRate(128), times, other)
    known = [rate for rate in whole if rate.time_s < times[half - 2]]
    assert changed[: len(known)] == known


@pytest.mark.parametrize("bpm", [40, 60, 100])
def test_a_pulse_that_is_upside_down_is_found_where_it_is(bpm: float) -> None:
    times = clock(60, 128)
    upright, reflected = (
        detect(PulseRate(128), times, sign * wave(times, bpm, 0)) for sign in (1, -1)
    )
    later = [rate for rate in reflected if rate.time_s > times[0] + 15]
    assert len(later) > 0.7 * bpm
    known = np.array([rate.time_s for rate in upright])
    assert max(np.abs(known - rate.time_s).min() for rate in later) < 0.02
