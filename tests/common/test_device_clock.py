"""Jumps, stalls, interleaved packets and the guarantees of the mapping."""

from __future__ import annotations

import math
import random
import sys
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.device_clock import (
    LONGEST_DELAY_S,
    DeviceClock,
    Reanchor,
    ReanchorReason,
)

OFFSET_S = 5_000.0
RATE_HZ = 10


def run(
    clock: DeviceClock, start: float, end: float, step: float = 0.0, seed: int = 0
) -> list[Reanchor]:
    """Feed packets from `start` to `end`; `step` is added to the device's time."""
    rng = random.Random(seed)
    jumps: list[Reanchor] = []
    for packet in range(round(start * RATE_HZ), round(end * RATE_HZ)):
        elapsed = packet / RATE_HZ
        jump = clock.observe(elapsed + step, elapsed + OFFSET_S + rng.uniform(0.0, 0.05))
        if jump is not None:
            jumps.append(jump)
    return jumps


def settled() -> DeviceClock:
    clock = DeviceClock()
    assert run(clock, 0, 60) == []
    return clock


def error_at(clock: DeviceClock, elapsed: float, step: float = 0.0) -> float:
    return clock.to_lsl(elapsed + step) - (elapsed + OFFSET_S)


def test_first_observation_anchors() -> None:
    clock = DeviceClock()

    assert clock.observe(12.0, 100.5) is None

    assert clock.to_lsl(12.0) == 100.5
    assert clock.to_lsl(11.0) == 99.5
    assert clock.state.offset_s == 88.5
    assert clock.state.observations == 1


def test_before_the_first_observation_nothing_is_known() -> None:
    clock = DeviceClock()

    state = clock.state
    assert math.isnan(state.offset_s)
    assert math.isnan(state.drift_ppm)
    assert math.isnan(state.residual_rms_s)
    assert state.observations == 0
    with pytest.raises(RuntimeError):
        clock.to_lsl(1.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e12, -1.7e308])
def test_readings_that_no_clock_makes_are_refused(bad: float) -> None:
    clock = settled()
    before = clock.state

    with pytest.raises(ValueError, match="no clock reads"):
        clock.observe(bad, 1.0)
    with pytest.raises(ValueError, match="no clock reads"):
        clock.observe(1.0, bad)
    with pytest.raises(ValueError, match="no clock reads"):
        clock.to_lsl(bad)
    assert clock.state == before


@pytest.mark.parametrize(
    ("step", "reason"),
    [
        (-3600.0, ReanchorReason.DEVICE_BACKWARD),
        (-3.0, ReanchorReason.DEVICE_BACKWARD),
        (1.5, ReanchorReason.BELOW),
        (3600.0, ReanchorReason.BELOW),
        (-2.0, ReanchorReason.STAYED_ABOVE),
        (-0.7, ReanchorReason.STAYED_ABOVE),
    ],
)
def test_a_step_of_the_device_clock_reanchors_once(step: float, reason: ReanchorReason) -> None:
    clock = settled()

    jumps = run(clock, 60, 90, step, seed=1)

    assert [jump.reason for jump in jumps] == [reason]
    assert jumps[0].size_s == pytest.approx(-step, abs=0.06)
    assert clock.state.reanchors == 1
    assert abs(error_at(clock, 89.9, step)) < 0.005


@pytest.mark.parametrize("step", [-0.15, -0.307, -0.45])
@pytest.mark.parametrize("rate_hz", [2, 10, 128])
def test_a_small_step_back_is_found_within_seconds(step: float, rate_hz: int) -> None:
    rng = random.Random(rate_hz)
    clock, found = DeviceClock(), list[float]()
    for packet in range(100 * rate_hz):
        elapsed = packet / rate_hz
        device = elapsed + step * (elapsed >= 60.0)
        if clock.observe(device, elapsed + OFFSET_S + rng.uniform(0.0, 0.02)) is not None:
            found.append(elapsed - 60.0)

    assert [after <= max(5.0, 20 / rate_hz) + 1.0 for after in found] == [True]
    assert abs(error_at(clock, 99.9, step)) < 0.005


@pytest.mark.parametrize("step", [-0.15, -0.307, -3.0, -30.0, -3600.0])
def test_a_kind_of_packets_that_turns_back_tells_a_step_at_once(step: float) -> None:
    rng = random.Random(1)
    clock, jumps = DeviceClock(), list[tuple[float, ReanchorReason]]()
    for packet in range(3000):
        elapsed = packet / 100
        device = elapsed + step * (elapsed >= 20.0) - 0.02 * (packet % 2)
        arrival = elapsed + OFFSET_S + rng.uniform(0.0, 0.005)
        jump = clock.observe(device, arrival, "ab"[packet % 2])
        jumps += [(elapsed, jump.reason)] if jump else []
        if elapsed > 10.0:
            assert abs(error_at(clock, elapsed, device - elapsed)) < 0.03

    assert jumps == [(20.0, ReanchorReason.DEVICE_BACKWARD)]


def test_kinds_that_lag_behind_each_other_do_not_turn_back() -> None:
    clock = DeviceClock()
    for packet in range(400):
        kind, elapsed = packet % 3, packet / 10
        device = elapsed - (0.0, 2.9, 20.0)[kind]
        assert clock.observe(device, elapsed + OFFSET_S, "abc"[kind]) is None


@pytest.mark.parametrize("delay_s", [0.1, 0.3, 0.45])
@pytest.mark.parametrize("swells_s", [4.0, 10.0, 30.0])
def test_a_way_that_is_busy_for_a_while_is_no_step(delay_s: float, swells_s: float) -> None:
    clock = settled()
    for packet in range(600, 1200):
        elapsed = packet / RATE_HZ
        way = delay_s * abs(math.sin(math.pi * (elapsed - 60.0) / swells_s))
        assert clock.observe(elapsed, elapsed + OFFSET_S + way) is None


@pytest.mark.parametrize("delay_s", [0.15, 0.3, 0.9])
def test_what_waits_for_a_busy_computer_is_no_step(delay_s: float) -> None:
    def jumps(own_delay_s: float) -> int:
        clock, rng = settled(), random.Random(1)
        for packet in range(600, 900):
            elapsed = packet / RATE_HZ
            arrival = elapsed + OFFSET_S + delay_s + rng.uniform(0.0, 0.05)
            clock.observe(elapsed, arrival, own_delay_s=own_delay_s)
        return clock.state.reanchors

    assert jumps(own_delay_s=delay_s) == 0
    assert jumps(own_delay_s=0.02) == 1


def test_a_delay_beyond_any_stall_reanchors_at_once() -> None:
    late_s = LONGEST_DELAY_S + 0.5
    clock = settled()

    jump = clock.observe(60.0, 60.0 + OFFSET_S + late_s)

    assert jump is not None
    assert jump.reason is ReanchorReason.FAR_ABOVE
    assert jump.size_s == pytest.approx(late_s, abs=0.01)
    assert clock.to_lsl(60.0) == 60.0 + OFFSET_S + late_s


def test_the_drift_survives_a_step() -> None:
    clock = DeviceClock()
    for packet in range(600):
        clock.observe(packet / 10 * (1 - 150e-6), packet / 10)
    learnt = clock.state.drift_ppm

    clock.observe(1_000_000.0, 60.0)

    assert clock.state.reanchors == 1
    assert clock.state.drift_ppm == learnt == pytest.approx(150.0, abs=1.0)


def test_a_small_forward_step_is_slewed_within_seconds() -> None:
    clock = settled()

    assert run(clock, 60, 66, step=0.3, seed=1) == []

    assert abs(error_at(clock, 65.9, 0.3)) < 0.01
    assert clock.to_lsl(60.0) < clock.to_lsl(60.3) < clock.to_lsl(60.4)


@pytest.mark.parametrize("stall_s", [0.5, 2.0, 8.0])
def test_a_stall_and_its_burst_leave_the_mapping_alone(stall_s: float) -> None:
    clock, undisturbed = settled(), settled()
    run(undisturbed, 60, 75, seed=1)
    rng = random.Random(1)
    for packet in range(600, 750):
        elapsed = packet / RATE_HZ
        delay = rng.uniform(0.0, 0.05)
        held_until = 62.0 + stall_s if 62.0 <= elapsed < 62.0 + stall_s else elapsed
        jump = clock.observe(elapsed, max(held_until, elapsed) + OFFSET_S + delay)
        assert jump is None
        assert abs(error_at(clock, elapsed)) < 0.003

    assert clock.to_lsl(74.9) == pytest.approx(undisturbed.to_lsl(74.9), abs=0.001)


def test_repeated_bursts_are_no_step() -> None:
    clock = settled()
    for packet in range(600, 1200):
        elapsed = packet / RATE_HZ
        release = math.ceil(elapsed / 2.0) * 2.0
        assert clock.observe(elapsed, release + OFFSET_S) is None

    assert abs(error_at(clock, 119.9)) < 0.01


def test_a_backlog_at_the_start_is_overcome() -> None:
    clock = DeviceClock()
    for packet in range(20):
        clock.observe(packet / RATE_HZ, OFFSET_S + 2.0)

    run(clock, 2, 8)

    assert abs(error_at(clock, 7.9)) < 0.01


def test_a_long_pause_keeps_offset_and_drift() -> None:
    clock = DeviceClock()
    rng = random.Random(3)

    def device(elapsed: float) -> float:
        return elapsed * (1 + 100e-6)

    for packet in range(1800):
        clock.observe(device(packet / 10), packet / 10 + rng.uniform(0.0, 0.05))
    assert clock.observe(device(780.0), 780.0 + 1.5) is None

    assert clock.to_lsl(device(780.0)) == pytest.approx(780.0, abs=0.01)


def test_interleaved_kinds_share_one_mapping() -> None:
    rng = random.Random(4)
    packets = sorted(
        (end + rng.uniform(0.0, 0.06), end - behind)
        for period, behind in ((0.252, 0.0), (0.4, 0.1), (1.008, 1.0), (1.0, 1.9))
        for end in (k * period for k in range(1, int(90 / period)))
    )
    clock = DeviceClock()
    for arrival, device in packets:
        assert clock.observe(device, arrival + OFFSET_S) is None
        if arrival > 15.0:
            assert abs(error_at(clock, device)) < 0.004

    assert clock.state.observations == len(packets)


@pytest.mark.parametrize("behind_s", [3.0, 20.0, 60.0])
@pytest.mark.parametrize("first", [0, 1])
def test_kinds_that_come_far_apart_do_not_move_the_clock_there_and_back(
    behind_s: float, first: int
) -> None:
    clock, jumps = DeviceClock(), list[Reanchor | None]()
    for packet in range(first, 400):
        elapsed = packet / RATE_HZ
        late = behind_s * (packet % 2)
        jumps.append(clock.observe(elapsed - late, elapsed + OFFSET_S))

    # A clock that hears the late kind first cannot know.
    assert sum(jump is not None for jump in jumps) == first
    assert abs(error_at(clock, 39.8)) < 0.001


@pytest.mark.parametrize("stall_s", [4.0, 15.0, 60.0])
def test_what_waited_is_late_though_its_kinds_come_one_after_the_other(stall_s: float) -> None:
    clock = settled()
    for device in [60.0 + stall_s * number / 100 for number in range(100)] * 3:
        assert clock.observe(device, 60.0 + stall_s + OFFSET_S) is None
    assert run(clock, 60 + stall_s, 75 + stall_s) == []
    assert abs(error_at(clock, 74.0 + stall_s)) < 0.005


@pytest.mark.parametrize("stall_s", [20.0, 60.0, 80.0])
@pytest.mark.parametrize("pace", [1.25, 2.0, 8.0])
def test_a_backlog_that_takes_long_to_catch_up_is_no_step(stall_s: float, pace: float) -> None:
    """What waited comes by way of another process, `pace` times as fast as it was measured."""
    clock = settled()
    end_s = 60.0 + stall_s * pace / (pace - 1) + 10.0
    for packet in range(600, round(end_s * RATE_HZ)):
        elapsed = packet / RATE_HZ
        passed_on = 60.0 + stall_s + (elapsed - 60.0) / pace
        assert clock.observe(elapsed, max(elapsed, passed_on) + OFFSET_S) is None
    assert abs(error_at(clock, end_s)) < 0.01


@pytest.mark.parametrize("step", [-0.8, -5.0])
def test_a_clock_that_was_set_while_a_backlog_came_is_found(step: float) -> None:
    clock, jumps = settled(), list[Reanchor]()
    for packet in range(600, 1100):
        elapsed = packet / RATE_HZ
        device = elapsed + step if elapsed > 65.0 else elapsed
        jump = clock.observe(device, max(elapsed, 80.0 + (elapsed - 60.0) / 8) + OFFSET_S)
        if jump is not None:
            jumps.append(jump)
    (jump,) = jumps
    assert jump.reason is ReanchorReason.STAYED_ABOVE
    assert abs(error_at(clock, 109.0, step)) < 0.01


def test_samples_of_one_packet_are_evenly_spaced() -> None:
    clock = DeviceClock()
    rng = random.Random(6)
    for packet in range(1, 100):
        end = packet * 0.252
        clock.observe(end, end + rng.uniform(0.0, 0.1))
        stamps = [clock.to_lsl(end - 0.004 * k) for k in range(63)]
        steps = [a - b for a, b in pairwise(stamps)]
        assert max(steps) - min(steps) < 1e-9


def test_mapped_samples_are_final() -> None:
    clock = settled()
    times = [50.0 + 0.01 * k for k in range(990)]
    before = [clock.to_lsl(time) for time in times]

    run(clock, 60, 63, step=0.3, seed=2)

    assert [clock.to_lsl(time) for time in times] == before


readings = st.floats(-1e10, 1e10)
packet_steps = st.tuples(st.floats(-3.0, 30.0), st.floats(-1.0, 30.0))
small_steps = st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0))


@given(readings, readings, st.lists(st.one_of(packet_steps, small_steps), max_size=60))
def test_the_mapping_never_turns_back(
    device: float, arrival: float, steps: list[tuple[float, float]]
) -> None:
    clock = DeviceClock()
    clock.observe(device, arrival)
    seen = [device]
    for device_step, arrival_step in steps:
        device += device_step
        arrival += arrival_step
        jump = clock.observe(device, arrival)
        seen = [device] if jump else [*seen, device]
        around = sorted(time + shift for time in seen for shift in (-0.01, 0.0, 0.01))
        stamps = [clock.to_lsl(time) for time in around]
        assert stamps == sorted(stamps)
        assert all(math.isfinite(stamp) for stamp in stamps)


@given(st.lists(st.tuples(st.floats(-5.0, 5.0), st.floats(0.0, 5.0)), min_size=2, max_size=60))
def test_the_mapping_is_strictly_increasing(steps: list[tuple[float, float]]) -> None:
    clock = DeviceClock()
    device = arrival = 0.0
    for device_step, arrival_step in steps:
        device += device_step
        arrival += arrival_step
        clock.observe(device, arrival)

    stamps = [clock.to_lsl(device + 0.001 * k) for k in range(-3000, 100)]
    assert all(later > earlier for earlier, later in pairwise(stamps))


@given(st.lists(st.tuples(st.floats(-1e11, 1e11), st.floats(-1e11, 1e11))))
def test_no_reading_of_a_clock_raises(packets: list[tuple[float, float]]) -> None:
    clock = DeviceClock()
    for device, arrival in packets:
        clock.observe(device, arrival)

    assert clock.state.observations == len(packets)


@pytest.mark.parametrize("rate_hz", [1, 128, 1000])
def test_memory_is_bounded(rate_hz: int) -> None:
    def footprint(clock: DeviceClock) -> int:
        parts = [*vars(clock).values()]
        columns = [column for part in parts for column in getattr(part, "__dict__", {}).values()]
        return sum(sys.getsizeof(column) for column in columns)

    clock = DeviceClock()
    for packet in range(15_000):
        clock.observe(packet / rate_hz, packet / rate_hz + 0.001 * (packet % 7))

    assert 1_000 < footprint(clock) < 50_000
