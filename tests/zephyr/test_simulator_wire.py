"""The virtual BioHarness's encoders against bytes of real devices and the layout."""

import json
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any

import pytest

from biosensor_gateway.devices.zephyr.simulator.wire import (
    DeviceStamp,
    Packet,
    Request,
    RequestReader,
    event,
    frame,
    general,
    response,
    summary_v2,
    waveform,
)

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
