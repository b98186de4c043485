"""Counted samples are where they were measured, whatever they had to wait for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.muse.driver.sample_clock import PacketSeries, SampleClock

SECONDS = 60.0
STAMP_LIMIT_S = 0.02


def errors_of(rate_hz: float, nominal_hz: float, samples: int, waits_s: np.ndarray) -> np.ndarray:
    """Return by how much each sample's time is wrong, of packets that wait so long."""
    clock = SampleClock(nominal_hz)
    errors: list[float] = []
    handed_on_s = 0.0
    for number, wait_s in enumerate(waits_s):
        first = number * samples
        measured_s = 1000.0 + (first + np.arange(samples)) / rate_hz
        handed_on_s = max(handed_on_s, measured_s[-1] + wait_s)
        clock.observe((first + samples - 1, handed_on_s))
        errors += (np.array(clock.times(range(first, first + samples))) - measured_s).tolist()
    return np.array(errors)


@pytest.mark.parametrize("deviation", [-0.003, -0.0005, 0.0, 0.0005, 0.003, 0.015])
@pytest.mark.parametrize("jitter_s", [0.0, 0.03, 0.1])
def test_times_are_right_and_even_at_any_rate(deviation: float, jitter_s: float) -> None:
    rate_hz = 64 * (1 + deviation)
    waits_s = np.random.default_rng(3).uniform(0, jitter_s, int(SECONDS * rate_hz / 6))
    errors = errors_of(rate_hz, 64.0, 6, waits_s)
    settled = errors[len(errors) // 2 :]
    assert np.abs(settled).max() < STAMP_LIMIT_S
    assert np.sqrt(np.mean(np.diff(settled) ** 2)) < 1e-3


def test_samples_that_wait_for_each_other_are_apart_all_the_same() -> None:
    # As an Athena hands on EEG: four samples a block, all blocks of 120 ms together.
    count = int(SECONDS * 256.3 / 4)
    last_s = (np.arange(count) * 4 + 3) / 256.3
    waits_s = np.ceil(last_s / 0.12) * 0.12 - last_s
    errors = errors_of(256.3, 256.0, 4, waits_s)
    settled = errors[len(errors) // 4 :]
    assert np.ptp(settled) < 0.01
    assert np.sqrt(np.mean(np.diff(settled) ** 2)) < 1e-3


def test_what_waits_for_a_busy_computer_moves_no_stamp() -> None:
    clock, late_s = SampleClock(64.0), 0.3
    for packet in range(400):
        is_late = packet >= 200
        last, measured_s = packet * 6 + 5, 1000.0 + (packet * 6 + 5) / 64
        clock.observe((last, measured_s + late_s * is_late), own_delay_s=late_s * is_late)
        assert clock.times([last])[0] == pytest.approx(measured_s, abs=0.002)


def test_a_host_that_slept_does_not_change_the_rate() -> None:
    waits_s = np.random.default_rng(4).uniform(0, 0.01, 1000)
    asleep = slice(500, 600)
    waits_s[asleep] += (100 - np.arange(100)) * 6 / 64
    errors = errors_of(64.0, 64.0, 6, waits_s)
    assert np.abs(errors[3600:]).max() < 0.02


def test_the_rate_outlives_a_restart() -> None:
    clock = SampleClock(64.0)
    for number in range(400):
        clock.observe((6 * number + 5, 50 + 6 * number / 64.2))
    assert clock.rate_hz == pytest.approx(64.2, rel=1e-4)
    clock.restart()
    assert clock.rate_hz == pytest.approx(64.2, rel=1e-4)
    clock.observe((3000, 500.0))
    assert np.diff(clock.times([3000, 3001])) == pytest.approx(1 / 64.2, rel=1e-3)


@given(st.integers(1, 400), st.sampled_from([1 << 16, 1 << 8]), st.integers(0, 65535))
def test_lost_packets_are_counted_over_a_turn_of_numbers(
    missing: int, modulus: int, first: int
) -> None:
    series = PacketSeries(modulus, 4, 256.0)
    for at in range(20):
        series.place((first + at) % modulus, 5 + at * 4 / 256)
    at = 20 + missing
    place = series.place((first + at) % modulus, 5 + at * 4 / 256 + 0.03)
    assert (place.lost, place.first, place.is_again) == (4 * missing, 4 * at, False)


def test_what_waited_is_not_lost() -> None:
    series = PacketSeries(1 << 16, 12, 256.0)
    series.place(7, 100.0)
    for number in range(8, 30):
        assert series.place(number, 115.0).lost == 0


@pytest.mark.parametrize("says_so", [True, False])
def test_a_device_that_counts_again_is_placed_by_time(says_so: bool) -> None:
    series = PacketSeries(1 << 16, 12, 256.0)
    for number in range(1000, 1100):
        series.place(number, 100 + number * 12 / 256)
    if says_so:
        series.restart()
    place = series.place(0, 100 + 1099 * 12 / 256 + 5.0)
    assert place.is_again
    assert place.lost == 5 * 256 - 12
    assert series.place(1, 200 + 1099 * 12 / 256).first == place.first + 12


def test_a_clock_that_began_again_tells_of_no_loss() -> None:
    series = PacketSeries(1 << 8, 4, 256.0)
    series.place(9, 1000.0)
    series.forget()
    assert series.place(0, 3.0).lost == 0
