"""The virtual BioHarness 3: its truth against the wire, its sources, and every fault."""

from __future__ import annotations

from datetime import date

import numpy as np
import pytest

from biosensor_gateway.devices.zephyr.simulator.bioharness import Outgoing
from biosensor_gateway.devices.zephyr.simulator.recording import (
    RECORDING_150_S,
    RECORDING_WITH_GAP,
    Arrival,
    RecordedSource,
    read_timing,
    split,
)
from biosensor_gateway.devices.zephyr.simulator.wire import (
    REQUESTS,
    WAVEFORMS,
    DeviceStamp,
    Packet,
    duration_ms,
    frame,
    response,
    waveform,
)
from biosensor_gateway.devices.zephyr.simulator.zephyr import (
    SyntheticSource,
)
from biosensor_gateway.simulation.wearer import Wearer
from tests.rigs.set_clock import SetClock

# The virtual BioHarness 3: its truth against the wire, and every fault.

BREATHING, ECG, RR, ACC, SUMMARY = 0x21, 0x22, 0x24, 0x25, 0x2B
ACK, NAK = 0x06, 0x15


# The virtual BioHarness's two sources, asked without a port, on a clock that is set.
ALL = frozenset(REQUESTS.values())
MONDAY = DeviceStamp(date(2026, 3, 2), 86_390_000)


def produce(
    source: SyntheticSource,
    until_s: float,
    step_s: float = 0.1,
    clock: SetClock | None = None,
) -> list[Outgoing]:
    source.power_on(clock or SetClock(100.0))
    times = 100.0 + np.arange(0, until_s + step_s / 2, step_s)
    return [out for now in times for out in source.poll(float(now), ALL)]


def of(packet: Packet, frames: list[Outgoing]) -> list[Outgoing]:
    return [out for out in frames if out.packet is packet]


def joined(
    packet: Packet, frames: list[Outgoing]
) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    return np.concatenate([out.samples for out in of(packet, frames) if out.samples is not None])


@pytest.mark.parametrize("packet", sorted(ALL))
def test_packets_follow_each_other_without_a_gap(packet: Packet) -> None:
    frames = of(packet, produce(SyntheticSource(clock_start=MONDAY), 20))
    assert len(frames) == 20_000 // duration_ms(packet)
    assert [out.sequence for out in frames] == list(range(len(frames)))
    late = 0 if packet in WAVEFORMS else 1
    for index, out in enumerate(frames):
        nominal = MONDAY.plus((index + late) * duration_ms(packet))
        assert out.stamp in {nominal.plus(jitter) for jitter in (-1, 0, 1)}
    if packet in WAVEFORMS:
        assert [out.first_index for out in frames] == [
            index * WAVEFORMS[packet].samples for index in range(len(frames))
        ]


def test_rr_flips_its_sign_at_each_beat_and_is_the_beat_interval() -> None:
    rr = joined(Packet.RR, produce(SyntheticSource(wearer=Wearer(heart_rate_bpm=60)), 62))[:, 0]
    changes = np.flatnonzero(np.diff(rr))
    np.testing.assert_array_equal(np.sign(rr[changes]), -np.sign(rr[changes + 1]))
    assert len(changes) in {60, 61, 62}
    beats = np.abs(rr[changes + 1])
    assert beats.mean() == pytest.approx(1000, abs=10)
    # A beat's value is the time since the beat before, which the 56 ms grid shows coarsely.
    np.testing.assert_allclose(np.diff(changes) * 56, beats[1:], atol=57)


@pytest.mark.parametrize("name", [RECORDING_150_S, RECORDING_WITH_GAP])
def test_a_recording_is_cut_without_losing_a_byte(name: str) -> None:
    source = RecordedSource.shipped(name)
    played = [*source.poll(0.0, ALL), *source.poll(1e6, ALL)]
    assert (
        sum(out.packet is not None for out in played)
        == {
            RECORDING_150_S: 1479,
            RECORDING_WITH_GAP: 1157,
        }[name]
        - 5
    )
    items = list(split(b"".join(out.data for out in played)))
    assert [item.data for item in items] == [out.data for out in played]


def test_a_frame_is_played_when_the_read_that_completed_it_arrived() -> None:
    first, second = (waveform(Packet.ECG, k, MONDAY, [512] * 63) for k in (0, 1))
    data = first + response(0x16, accepted=True) + second
    reads = read_timing("50.0,10\n50.5,93\n51.0,150\n52.0,191\n")
    assert reads[1] == Arrival(50.5, 93)
    source = RecordedSource(data, reads, speed=2.0)
    enabled = frozenset({Packet.ECG})
    played = [[out.data for out in source.poll(now, enabled)] for now in (7.0, 7.74, 7.76)]
    assert played == [[first], [], [second]]


def test_without_reads_a_frame_is_played_when_its_samples_are_complete() -> None:
    breathing = waveform(Packet.BREATHING, 0, MONDAY, [512] * 18)
    ecg = waveform(Packet.ECG, 0, MONDAY.plus(1500), [512] * 63)
    source = RecordedSource(breathing + frame(Packet.LIFESIGN) + b"junk" + ecg)
    enabled = frozenset({Packet.ECG, Packet.BREATHING})
    assert len(source.poll(0.0, enabled)) == 3
    assert source.poll(0.74, enabled) == []
    assert [out.data for out in source.poll(0.745, enabled)] == [ecg]
