"""The virtual BioHarness 3: its truth against the wire, its sources, and every fault."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from datetime import date
from typing import NamedTuple

import numpy as np
import pytest
import serial
from numpy.typing import NDArray

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
    Inputs,
    SimulatedZephyr,
    SyntheticSource,
)
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.truth import Samples
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import World
from tests.rigs.serial_hosts import SerialHosts
from tests.rigs.set_clock import SetClock
from tests.rigs.virtual_time import pause

# The virtual BioHarness 3: its truth against the wire, and every fault.

DEADLINE_S = 20.0
ECG_ON = bytes.fromhex("021601015e03")
BREATHING, ECG, RR, ACC, SUMMARY = 0x21, 0x22, 0x24, 0x25, 0x2B
ACK, NAK = 0x06, 0x15


class Heard(NamedTuple):
    """A frame as this file's own small reader sees it."""

    message_id: int
    end: int
    payload: bytes

    @property
    def sequence(self) -> int:
        return self.payload[0]

    @property
    def device_ms(self) -> int:
        return int.from_bytes(self.payload[5:9], "little")

    def counts(self) -> NDArray[np.int64]:
        """Values of ten bits, the first in the lowest bits."""
        bits = int.from_bytes(self.payload[9:], "little")
        count = 8 * len(self.payload[9:]) // 10
        return np.array([bits >> 10 * k & 0x3FF for k in range(count)], np.int64)


class Host:
    """The other end of the port."""

    def __init__(self, port: str) -> None:
        self._serial = serial.Serial(port, 115200, timeout=0.02, write_timeout=2)
        self._unread = b""
        self.junk = 0
        self.frames: list[Heard] = []

    def send(self, data: bytes) -> None:
        self._serial.write(data)

    def listen(self) -> None:
        data = self._serial.read(1)
        self._unread += data + self._serial.read(self._serial.in_waiting)
        while len(self._unread) >= 5:
            size = self._unread[2] + 5
            frame = self._unread[:size]
            if self._unread[0] == 2 and self._unread[2] <= 128:
                if len(self._unread) < size:
                    return
                if frame[-1] in (3, ACK, NAK):
                    self.frames.append(Heard(frame[1], frame[-1], frame[3:-2]))
                    self._unread = self._unread[size:]
                    continue
            self._unread = self._unread[1:]
            self.junk += 1

    def until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < deadline, "the device did not do it"
            self.listen()

    def ask(self, request: bytes) -> int:
        """Send a request; return how its answer ends."""

        def answers() -> list[Heard]:
            return [
                heard
                for heard in self.frames
                if heard.message_id == request[1] and heard.end in (ACK, NAK)
            ]

        before = len(answers())
        self.send(request)
        self.until(lambda: len(answers()) > before)
        return answers()[-1].end

    def of(self, message_id: int) -> list[Heard]:
        return [each for each in self.frames if (each.message_id, each.end) == (message_id, 3)]

    def wait_for(self, message_id: int, count: int) -> list[Heard]:
        self.until(lambda: len(self.of(message_id)) >= count)
        return self.of(message_id)

    def until_hung_up(self) -> None:
        with pytest.raises(OSError):
            self.until(lambda: False)

    def close(self) -> None:
        self._serial.close()


@pytest.fixture
def hosts() -> Iterator[SerialHosts[Host]]:
    running = SerialHosts(Host)
    yield running
    running.close()


@pytest.fixture
def device() -> Iterator[SimulatedZephyr]:
    with World() as world, SimulatedZephyr(world, seed=5) as running:
        yield running


@pytest.fixture
def host(hosts: SerialHosts[Host], device: SimulatedZephyr) -> Host:
    return hosts.connect(device.settings["port"])


def settled(device: SimulatedZephyr, data_name: str, count: int) -> Samples:
    """Wait until the truth holds so many samples: it is noted just after the sending."""
    deadline = time.monotonic() + DEADLINE_S
    while len((found := device.truth.samples(data_name)).times) < count:
        assert time.monotonic() < deadline
        pause(0.01)
    return found


def test_restart_begins_with_packet_0_and_a_clock_that_went_on(
    hosts: SerialHosts[Host], host: Host, device: SimulatedZephyr
) -> None:
    assert host.ask(ECG_ON) == ACK
    before = host.wait_for(ECG, 6)[-1]
    device.apply(Fault(FaultKind.RESTART, 0.3))
    host.until_hung_up()
    again = hosts.connect(device.settings["port"])
    assert again.ask(ECG_ON) == ACK
    after = again.wait_for(ECG, 1)[0]
    assert after.sequence < before.sequence
    assert after.device_ms > before.device_ms


def test_a_restart_ends_no_drop(
    hosts: SerialHosts[Host], host: Host, device: SimulatedZephyr
) -> None:
    device.apply(Fault(FaultKind.DROP, math.inf))
    host.until_hung_up()
    device.apply(Fault(FaultKind.RESTART, math.inf))
    device.clear(FaultKind.RESTART)
    with pytest.raises(OSError):
        Host(device.settings["port"])
    device.clear(FaultKind.DROP)
    assert hosts.connect(device.settings["port"]).ask(ECG_ON) == ACK


def test_drift_changes_the_pace_of_the_truth(host: Host, device: SimulatedZephyr) -> None:
    assert host.ask(ECG_ON) == ACK
    host.wait_for(ECG, 2)
    device.apply(Fault(FaultKind.DRIFT, 50_000))
    numbers = [each.sequence for each in host.wait_for(ECG, 8)]
    assert set(np.diff(numbers)) == {1}
    steps = np.diff(settled(device, "ecg", 8 * 63).times)
    assert steps[0] == pytest.approx(0.004, rel=1e-4)
    assert steps[-1] == pytest.approx(0.004 / 1.05, rel=1e-4)


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


def test_equal_seeds_give_equal_bytes_and_others_do_not() -> None:
    first, again, other = (
        [out.data for out in produce(SyntheticSource(seed=seed, jitter_s=0.05), 5)]
        for seed in (4, 4, 5)
    )
    assert first == again
    assert first != other


def test_bytes_do_not_depend_on_how_often_the_source_is_asked() -> None:
    often = produce(SyntheticSource(), 5, step_s=0.01)
    seldom = produce(SyntheticSource(), 5, step_s=5)
    assert [out.data for out in often] == [out.data for out in seldom]


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


def test_a_packet_leaves_when_its_last_sample_is_measured_or_later() -> None:
    source = SyntheticSource(jitter_s=0.2)
    source.power_on(SetClock(0.0))
    assert of(Packet.ECG, source.poll(0.2519, ALL)) == []
    assert [out.sequence for out in of(Packet.ECG, source.poll(0.4521, ALL))] == [0]


def test_packets_that_nobody_enabled_are_measured_but_not_given() -> None:
    source = SyntheticSource()
    source.power_on(SetClock(0.0))
    assert source.poll(10.0, frozenset()) == []
    later = source.poll(12.0, frozenset({Packet.ECG}))
    assert [out.sequence for out in later] == list(range(39, 47))
    assert {out.packet for out in later} == {Packet.ECG}


def test_a_fast_oscillator_measures_its_samples_sooner() -> None:
    frames = of(Packet.ECG, produce(SyntheticSource(drift_ppm=200), 60))
    spacing = np.diff([out.measured_at or 0.0 for out in frames])
    np.testing.assert_allclose(spacing, 0.252 / 1.0002, rtol=1e-6)


def test_ecg_has_as_many_r_peaks_as_the_heart_beats() -> None:
    ecg = joined(Packet.ECG, produce(SyntheticSource(wearer=Wearer(heart_rate_bpm=72)), 61))[
        : 250 * 60, 0
    ]
    above = ecg > 512 + 65
    assert np.count_nonzero(above[1:] & ~above[:-1]) in {71, 72, 73}
    assert ecg.min() >= 0
    assert ecg.max() <= 1023


def test_rr_flips_its_sign_at_each_beat_and_is_the_beat_interval() -> None:
    rr = joined(Packet.RR, produce(SyntheticSource(wearer=Wearer(heart_rate_bpm=60)), 62))[:, 0]
    changes = np.flatnonzero(np.diff(rr))
    np.testing.assert_array_equal(np.sign(rr[changes]), -np.sign(rr[changes + 1]))
    assert len(changes) in {60, 61, 62}
    beats = np.abs(rr[changes + 1])
    assert beats.mean() == pytest.approx(1000, abs=10)
    # A beat's value is the time since the beat before, which the 56 ms grid shows coarsely.
    np.testing.assert_allclose(np.diff(changes) * 56, beats[1:], atol=57)


def test_a_wearer_at_rest_feels_one_g() -> None:
    counts = joined(Packet.ACCELERATION, produce(SyntheticSource(), 10))
    g = np.linalg.norm((counts - 512) / 20.75, axis=1)
    assert g.mean() == pytest.approx(1.0, abs=0.03)
    tenths = joined(Packet.ACCELERATION_100MG, produce(SyntheticSource(), 10))
    assert np.linalg.norm(tenths / 10, axis=1).mean() == pytest.approx(1.0, abs=0.05)


def test_any_packet_is_known_without_those_before() -> None:
    frames = of(Packet.BREATHING, produce(SyntheticSource(seed=7), 10))
    assert frames[8].samples is not None
    np.testing.assert_array_equal(frames[8].samples, Inputs(Wearer(7)).samples(Packet.BREATHING, 8))


def test_hrv_is_unreliable_until_it_is_valid() -> None:
    summaries = of(Packet.SUMMARY, produce(SyntheticSource(hrv_after_s=3), 6))
    values = [out.values or {} for out in summaries]
    assert [v["hrv_ms"] is None for v in values] == [True, True, False, False, False, False]
    assert [v["status_info"] for v in values] == [0x200, 0x200, 0, 0, 0, 0]


def test_the_clock_turns_midnight_and_can_be_set() -> None:
    source, clock = SyntheticSource(clock_start=MONDAY), SetClock(100.0)
    frames = of(Packet.SUMMARY, produce(source, 12, clock=clock))
    stamps = [out.stamp for out in frames if out.stamp]
    assert stamps[8].day == date(2026, 3, 2)
    assert stamps[10].day == date(2026, 3, 3)
    assert stamps[10].ms_of_day < 1100
    clock.now_s = 112.0
    source.midnight_in(500)
    (turned,) = [out.stamp for out in of(Packet.SUMMARY, source.poll(113.0, ALL))]
    assert turned is not None
    assert turned.day == date(2026, 3, 4)
    assert abs(turned.ms_of_day - 500) <= 1


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


def test_playback_waits_for_more_enables_and_plays_only_what_is_enabled() -> None:
    source = RecordedSource.shipped(speed=1e6)
    enabled = frozenset({Packet.RR})
    assert source.poll(0.0, enabled) == []
    assert source.poll(0.9, enabled) == []
    source.poll(1.0, enabled)
    kinds = {out.packet for out in source.poll(2.0, enabled)}
    assert kinds == {Packet.RR, Packet.LIFESIGN, Packet.EVENT, None}


def test_a_recording_must_hold_something() -> None:
    with pytest.raises(ValueError, match="nothing"):
        RecordedSource(response(0x16, accepted=True))
