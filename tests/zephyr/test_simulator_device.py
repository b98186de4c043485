"""The virtual BioHarness 3: its truth against the wire, its sources, and every fault."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Generator, Mapping
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from biosensor_common.errors import TransportError, TransportReason
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.devices.zephyr.driver import DRIVER, ZephyrSettings
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
    Request,
    RequestReader,
    duration_ms,
    event,
    frame,
    general,
    response,
    summary_v2,
    waveform,
)
from biosensor_gateway.devices.zephyr.simulator.zephyr import SyntheticSource
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.transports.byte_links import TcpLink
from tests.rigs.set_clock import SetClock
from tests.rigs.zephyr import SteeredBioHarness

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


# The virtual BioHarness's encoders against bytes of real devices and the layout.

Expected = Mapping[str, Any]
VECTORS: dict[str, dict[str, Any]] = {
    vector["name"]: vector
    for vector in json.loads(
        (Path(__file__).parent / "vectors" / "zephyr_bioharness.json").read_text("utf-8")
    )["vectors"]
}
# What a reader does with broken input, and packets that the virtual device does not send.
NOT_TO_ENCODE = {
    "bad_crc_then_good",
    "stx_inside_payload_after_lost_bytes",
    "dlc_over_128",
    "gen_summary3_basic",
    "gen_general_old_firmware_ack_terminator",
}
UNDESCRIBED: dict[str, dict[str, int]] = {
    "gen_summary2_flags": {"reserved": 0xFFFF},
    "gen_general_all_invalid": {"unused_1": 0xFFFF, "unused_2": 0xFFFF},
}
ROG = {"green": 1, "orange": 2, "red": 3}
NOT_FIELDS = {"msg_id", "dlc", "terminator", "seq", "time", "ms_of_day", "rog_status", "rog_time_s"}
STATUS_PARTS = {"worn_level", "button", "not_fitted"}


def stamp_of(expected: Expected) -> DeviceStamp:
    return DeviceStamp(date.fromisoformat(expected["time"][:10]), expected["ms_of_day"])


def summary_fields(expected: Expected) -> dict[str, Any]:
    fields = {
        name: value
        for name, value in expected.items()
        if name not in NOT_FIELDS | STATUS_PARTS | {"aux_adc", "version"}
        and not name.endswith("_unreliable")
    }
    aux = {f"aux_adc_{k}": value for k, value in enumerate(expected["aux_adc"], 1)}
    rog = ROG[expected["rog_status"]] | expected["rog_time_s"] << 3
    return fields | aux | {"rog": rog}


def general_fields(expected: Expected) -> dict[str, Any]:
    bits = ("external_sensors", "hr_signal_low", "button", "worn")
    fields = {name: v for name, v in expected.items() if name not in {*NOT_FIELDS, *bits}}
    return fields | {"flags": sum(expected[bit] << k for k, bit in enumerate(bits, 4))}


def encode(name: str, expected: Expected) -> bytes:
    message_id = expected["msg_id"]
    if expected["terminator"] == "ACK":
        return response(message_id, accepted=True)
    if "seq" not in expected:
        return frame(message_id, bytes.fromhex(expected.get("payload", "")))
    sequence, stamp = expected["seq"], stamp_of(expected)
    if message_id == Packet.EVENT:
        return event(sequence, stamp, expected["code"], bytes.fromhex(expected["data"]))
    if message_id == Packet.SUMMARY:
        return summary_v2(sequence, stamp, summary_fields(expected) | UNDESCRIBED.get(name, {}))
    if message_id == Packet.GENERAL:
        return general(sequence, stamp, general_fields(expected) | UNDESCRIBED.get(name, {}))
    values = expected.get("samples") or [v for xyz in expected["xyz"] for v in xyz]
    return waveform(Packet(message_id), sequence, stamp, values)


@pytest.mark.parametrize("name", sorted(VECTORS.keys() - NOT_TO_ENCODE))
def test_encoders_reproduce_the_recorded_and_documented_bytes(name: str) -> None:
    vector = VECTORS[name]
    assert encode(name, vector["expected"]).hex() == vector["hex"]


def test_general_data_example_of_the_layout() -> None:
    values = {
        "heart_rate_bpm": 132,
        "respiration_rate_bpm": 17.3,
        "skin_temperature_c": 35.7,
        "posture_deg": -25,
        "activity_vmu_g": 2.56,
        "peak_accel_g": 6.79,
        "battery_v": 3.904,
        "breathing_wave_amplitude": 1200,
        "ecg_amplitude_v": 0.002376,
        "ecg_noise_v": 0.001245,
        "vertical_min_g": -0.83,
        "vertical_peak_g": 12.25,
        "lateral_min_g": -0.1,
        "lateral_peak_g": 0.2,
        "sagittal_min_g": -0.05,
        "sagittal_peak_g": 0.44,
        "gsr_ns": 10,
        "rog": 1,
        "battery_percent": 87,
        "flags": 0x80,
    }
    assert general(7, DeviceStamp(date(2026, 1, 31), 86398744), values) == bytes.fromhex(
        "02203507EA07011F185726058400AD006501E7FF0001A702400FB0044809DD04"
        "ADFFC904F6FF1400FBFF2C0000000A000000000001005780A803"
    )


def test_acceleration_in_100_mg_is_packed_as_twos_complement() -> None:
    data = waveform(Packet.ACCELERATION_100MG, 0, DeviceStamp(date(2026, 1, 1), 0), [-1] * 60)
    assert data[12:-2] == b"\xff" * 75


@pytest.mark.parametrize(("name", "broken"), [("bad_crc_then_good", 0x14), ("dlc_over_128", 0x22)])
def test_a_broken_request_is_reported_and_the_next_one_is_read(name: str, broken: int) -> None:
    first, *_, last = RequestReader().feed(bytes.fromhex(VECTORS[name]["hex"]), now=0.0)
    assert (first.request_id, first.intact) == (broken, False)
    assert last == Request(Packet.LIFESIGN, b"", intact=True)


# The virtual BioHarness on TCP, as where there are no pseudo-terminals.

DEADLINE_S = 30.0


@pytest.fixture
def device() -> Generator[SteeredBioHarness]:
    with SteeredBioHarness(SyntheticSource(seed=2), tcp=True) as running:
        yield running


async def _until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline, "it did not happen"
        await asyncio.sleep(0.02)


def _pushed(sink: DeviceSink) -> int:
    return next((c.pushed for name, c in sink.counters.items() if name.endswith("ecg")), 0)


async def test_a_driver_streams_and_comes_back_after_a_hang_up(
    device: SteeredBioHarness,
) -> None:
    settings = ZephyrSettings(sensor="zephyr", unit="TCP", port=device.port)
    sink = DeviceSink(DeviceIdentity("zephyr", "TCP"), declaration("zephyr"))
    supervisor = Supervisor(DRIVER.make(settings, sink), sink)
    task = asyncio.create_task(supervisor.run())
    try:
        await _until(lambda: _pushed(sink) > 200)
        await asyncio.to_thread(device.drop_link, 0.5)
        await _until(lambda: supervisor.connections == 2)
        before = _pushed(sink)
        await _until(lambda: _pushed(sink) > before + 200)
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        sink.close()


async def test_while_it_hangs_up_connections_are_refused(device: SteeredBioHarness) -> None:
    await asyncio.to_thread(device.drop_link)
    host, _, port = device.port.removeprefix("socket://").partition(":")
    link = TcpLink(host, int(port))
    with pytest.raises(TransportError) as refused:
        await link.open()
    await link.close()
    assert refused.value.reason is TransportReason.ABSENT
