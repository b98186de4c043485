"""Packets of a Muse 2 or Muse S and frames of an Athena, against vectors and any bytes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.muse.driver.emitter import PATIENCE, RowAssembler, Rows
from biosensor_gateway.devices.muse.driver.frames import (
    Block,
    Kind,
    charge_counts,
    eeg_uv,
    light,
    motion,
    parse_notification,
)
from biosensor_gateway.devices.muse.driver.protocol import (
    ACC_G,
    GYRO_DPS,
    Packet,
    parse_charge,
    parse_eeg,
    parse_light,
    parse_motion,
)
from biosensor_gateway.devices.muse.driver.sample_clock import PacketSeries, SampleClock
from tests.muse.known import VECTORS, bytes_of, of_kind

# Packets of a Muse 2 or Muse S, and what is put together of them.

READERS: dict[str, Callable[[bytes], Packet | None]] = {
    "eeg": parse_eeg,
    "light": parse_light,
    "acc": lambda data: parse_motion(data, ACC_G),
    "gyro": lambda data: parse_motion(data, GYRO_DPS),
}


@of_kind(*READERS)
def test_a_packet_is_read_as_its_vector_says(vector: dict[str, Any]) -> None:
    packet = READERS[vector["kind"]](bytes_of(vector))
    if vector["expected"] is None:
        assert packet is None
        return
    assert packet is not None
    assert packet.number == vector["expected"]["number"]
    np.testing.assert_allclose(packet.samples, vector["expected"]["samples"], rtol=1e-12)


def test_rotation_is_in_the_unit_of_other_programs() -> None:
    # muse-lsl and muse-js have it in seven digits.
    assert pytest.approx(0.0074768, rel=1e-5) == GYRO_DPS


@of_kind("telemetry")
def test_a_battery_level_is_one_or_none(vector: dict[str, Any]) -> None:
    assert parse_charge(bytes_of(vector)) == vector["expected"]


@given(st.binary(max_size=40))
def test_any_bytes_are_a_packet_or_none(data: bytes) -> None:
    for read in READERS.values():
        packet = read(data)
        assert (packet is None) == (len(data) != 20)
        assert packet is None or np.isfinite(packet.samples).all()
    percent = parse_charge(data)
    assert percent is None or 0 <= percent <= 100


def packet(number: int, value: float) -> Packet:
    return Packet(number, np.full(3, value))


def fed(assembler: RowAssembler, *arrived: tuple[int, int]) -> list[Rows]:
    """Give packets by channel and number; each holds its channel and its number."""
    return [
        rows
        for channel, number in arrived
        for rows in assembler.take(channel, packet(number, 10 * number + channel))
    ]


def test_channels_are_complete_with_the_last_one_in_any_order() -> None:
    rows = fed(RowAssembler(3, 3), (2, 5), (0, 5), (1, 5), (1, 6), (2, 6), (0, 6))
    assert [each.number for each in rows] == [5, 6]
    assert rows[0].samples.tolist() == [[50, 51, 52]] * 3


def test_a_packet_that_is_missing_is_no_value_in_its_channel_alone() -> None:
    rows = fed(RowAssembler(3, 3), (0, 1), (2, 1), (0, 2), (1, 2), (2, 2))
    assert [each.number for each in rows] == [1, 2]
    np.testing.assert_array_equal(rows[0].samples[0], [10, np.nan, 12])
    assert not np.isnan(rows[1].samples).any()


def test_a_channel_that_never_comes_is_waited_for_only_at_first() -> None:
    assembler = RowAssembler(3, 3)
    pairs = [(channel, number) for number in range(PATIENCE + 2) for channel in (0, 1)]
    rows = fed(assembler, *pairs)
    assert [each.number for each in rows] == list(range(PATIENCE + 2))
    assert all(np.isnan(each.samples[:, 2]).all() for each in rows)
    # Once it comes, it is waited for again.
    assert not fed(assembler, (2, 9), (0, 9))


def test_what_comes_twice_or_too_late_is_counted() -> None:
    assembler = RowAssembler(2, 3)
    rows = fed(assembler, (0, 1), (0, 1), (1, 1), (1, 1), (0, 2), (0, 3), (1, 2), (1, 3))
    assert assembler.late == 3 * 3
    assert [each.number for each in rows] == [1, 2, 3]
    assert np.isnan(rows[1].samples[:, 1]).all()


def test_what_was_held_of_an_earlier_connection_is_gone() -> None:
    assembler = RowAssembler(2, 3)
    fed(assembler, (0, 7))
    assembler.forget()
    assert [each.number for each in fed(assembler, (0, 0), (1, 0))] == [0]


# Frames of an Athena, against vectors, cuts and any bytes.
WHOLE = [bytes_of(each) for each in VECTORS if each["kind"] == "frame" and each["expected"]]


def samples_of(block: Block) -> np.ndarray[Any, Any] | None:
    match block.kind:
        case Kind.EEG4 | Kind.EEG8:
            return eeg_uv([block])
        case Kind.LIGHT4 | Kind.LIGHT8 | Kind.LIGHT16:
            return light([block])
        case Kind.MOTION:
            return np.concatenate(motion([block]), axis=1)
        case _:
            return None


@of_kind("frame")
def test_a_frame_is_read_as_its_vector_says(vector: dict[str, Any]) -> None:
    data, expected = bytes_of(vector), vector["expected"]
    frames, unread = parse_notification(data)
    if expected is None:
        assert (frames, unread) == ([], len(data))
        return
    (frame,) = frames
    assert (frame.counter, unread) == (expected["counter"], expected["unread"])
    assert [each.kind.name for each in frame.blocks] == [
        each["kind"] for each in expected["blocks"]
    ]
    for block, known in zip(frame.blocks, expected["blocks"], strict=True):
        assert block.number == known["number"]
        assert round(1e6 * block.stamp_s) == known["stamp_us"]
        if "samples" in known:
            samples = samples_of(block)
            assert samples is not None
            np.testing.assert_allclose(samples, known["samples"], rtol=1e-12)
        if "charge" in known:
            assert charge_counts(block) == known["charge"]


def test_several_frames_of_a_notification_are_read_alike() -> None:
    alone = [parse_notification(data) for data in WHOLE]
    frames, unread = parse_notification(b"".join(WHOLE))
    assert frames == [frame for found, _ in alone for frame in found]
    assert unread == sum(each for _, each in alone)


def test_a_frame_that_is_cut_costs_itself_alone() -> None:
    for cut in range(1, len(WHOLE[1])):
        frames, unread = parse_notification(WHOLE[0] + WHOLE[1][:-cut])
        assert frames == parse_notification(WHOLE[0])[0]
        assert unread == len(WHOLE[1]) - cut


@given(st.binary(max_size=300))
def test_any_bytes_are_read_to_the_last_or_counted(data: bytes) -> None:
    frames, unread = parse_notification(data)
    read = sum(9 + sum(5 + len(block.payload) for block in frame.blocks) for frame in frames)
    assert read + unread == len(data)
    for frame in frames:
        for block in frame.blocks:
            samples = samples_of(block)
            assert samples is None or np.isfinite(samples).all()


@given(st.sampled_from(WHOLE), st.data())
def test_a_byte_that_is_flipped_or_missing_raises_nothing(
    whole: bytes, data: st.DataObject
) -> None:
    at = data.draw(st.integers(0, len(whole) - 1))
    flipped = bytearray(whole)
    flipped[at] ^= 1 << data.draw(st.integers(0, 7))
    for broken in (bytes(flipped), whole[:at] + whole[at + 1 :]):
        frames, unread = parse_notification(broken)
        assert 0 <= unread <= len(broken)
        assert len(frames) <= 1


# Counted samples are where they were measured, whatever they had to wait for.

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
