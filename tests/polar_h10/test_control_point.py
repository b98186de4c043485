"""Commands and replies of the PMD control point, against vectors and against any bytes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import (
    Measurement,
    Reply,
    Setting,
    Status,
    Stopped,
    choose,
    get_settings,
    parse_features,
    parse_indication,
    parse_settings,
    start,
    stop,
)

_FOLDER = Path(__file__).parent / "vectors"
VECTORS: list[dict[str, Any]] = [
    vector
    for name in ("polar_pmd_h10.json", "polar_pmd_verity.json")
    for vector in json.loads((_FOLDER / name).read_text(encoding="utf-8"))
]
REPLIES = [
    vector for vector in VECTORS if vector["kind"] == "control_point" and "op" in vector["expected"]
]
FEATURES = [vector for vector in VECTORS if "features" in vector["expected"]]
COMMANDS = {vector["name"]: vector["hex"] for vector in VECTORS if vector["kind"] == "command"}
NEVER_SENT = {"cmd_measurement_status", "cmd_start_sdk_mode"}
SETTING_NAMES = {
    "sample_rate": Setting.SAMPLE_RATE,
    "resolution": Setting.RESOLUTION,
    "range": Setting.RANGE,
    "factor": Setting.FACTOR,
}
ACC_OFFER = {
    Setting.SAMPLE_RATE: (25, 50, 100, 200),
    Setting.RESOLUTION: (16,),
    Setting.RANGE: (2, 4, 8),
}


def acc(rate: int, range_g: int) -> dict[Setting, int]:
    return {Setting.RANGE: range_g, Setting.SAMPLE_RATE: rate, Setting.RESOLUTION: 16}


@pytest.mark.parametrize("vector", FEATURES, ids=lambda vector: vector["name"])
def test_features_vector(vector: dict[str, Any]) -> None:
    assert sorted(parse_features(bytes.fromhex(vector["hex"]))) == vector["expected"]["features"]


@pytest.mark.parametrize("vector", REPLIES, ids=lambda vector: vector["name"])
def test_reply_vector(vector: dict[str, Any]) -> None:
    reply = parse_indication(bytes.fromhex(vector["hex"]))
    assert isinstance(reply, Reply)
    expected = vector["expected"]
    assert (reply.operation, reply.measurement) == (expected["op"], expected["type"])
    assert Status(reply.status).name == reply.status_text == expected["status"]
    assert reply.more == expected["more"]
    if "params_hex" in expected:
        assert reply.parameters.hex() == expected["params_hex"]
        settings = parse_settings(reply.parameters)
        assert settings.keys() == {SETTING_NAMES[name] for name in expected["settings"]}
        for name, values in expected["settings"].items():
            assert list(settings[SETTING_NAMES[name]]) == pytest.approx(values, rel=1e-6)


BUILT = {
    "cmd_get_ecg_settings": get_settings(Measurement.ECG),
    "cmd_get_acc_settings": get_settings(Measurement.ACCELERATION),
    "cmd_start_ecg_130_14": start(
        Measurement.ECG, {Setting.SAMPLE_RATE: 130, Setting.RESOLUTION: 14}
    ),
    "cmd_start_acc_200_16_8g": start(Measurement.ACCELERATION, acc(200, 8)),
    "cmd_start_acc_25_16_2g": start(Measurement.ACCELERATION, acc(25, 2)),
    "cmd_stop_ecg": stop(Measurement.ECG),
    "cmd_stop_acc": stop(Measurement.ACCELERATION),
    "cmd_start_ppi": start(Measurement.PULSE_INTERVALS, {}),
    "cmd_start_ppg_55_22_4ch": start(
        Measurement.PPG, {Setting.SAMPLE_RATE: 55, Setting.RESOLUTION: 22, Setting.CHANNELS: 4}
    ),
}


@pytest.mark.parametrize("name", sorted(COMMANDS.keys() - NEVER_SENT))
def test_command_vector(name: str) -> None:
    assert BUILT[name].hex() == COMMANDS[name]


def test_a_reply_may_be_shorter_than_its_fields_and_have_an_unknown_status() -> None:
    reply = parse_indication(bytes.fromhex("f00200c8"))
    assert isinstance(reply, Reply)
    assert (reply.status, reply.more, reply.parameters) == (200, False, b"")
    assert "200" in reply.status_text


def test_the_device_may_stop_measurements_by_itself() -> None:
    assert parse_indication(bytes.fromhex("010002")) == Stopped((0, 2))


@pytest.mark.parametrize("text", ["", "0f0500", "f0", "f00200", "02"])
def test_anything_else_is_no_indication(text: str) -> None:
    assert parse_indication(bytes.fromhex(text)) is None


@pytest.mark.parametrize("text", ["", "0f", "0f05", "f00500"])
def test_without_features_nothing_is_offered(text: str) -> None:
    assert parse_features(bytes.fromhex(text)) == frozenset()


@pytest.mark.parametrize("text", ["00", "01", "0002", "000282", "00028200ff"])
def test_settings_that_are_cut_short_are_left_out(text: str) -> None:
    assert parse_settings(bytes.fromhex(text)) == {}


def test_settings_of_other_sizes_are_read_and_an_unknown_one_ends_them() -> None:
    parameters = bytes.fromhex("0301e8030000 0401 04 0601" + "aa" * 16 + "09010203 00018200")
    assert parse_settings(parameters) == {
        Setting.RANGE_MILLIUNIT: (1000,),
        Setting.CHANNELS: (4,),
        Setting.SECURITY: (int.from_bytes(b"\xaa" * 16, "little"),),
    }


@pytest.mark.parametrize(("wanted", "rate"), [(50, 50), (60, 50), (199, 100), (500, 200), (10, 25)])
def test_the_wanted_rate_or_the_next_lower_one_is_chosen(wanted: int, rate: int) -> None:
    assert choose(ACC_OFFER, {Setting.SAMPLE_RATE: wanted, Setting.RANGE: 4}) == acc(rate, 4)


def test_nothing_is_chosen_of_what_a_start_cannot_say() -> None:
    offered = {Setting.FACTOR: (0.5,), Setting.CHANNELS: (), Setting.RESOLUTION: (14, 16)}
    assert choose(offered, {Setting.SAMPLE_RATE: 130}) == {Setting.RESOLUTION: 16}


@given(st.binary(max_size=512))
def test_any_bytes_are_understood_or_not(data: bytes) -> None:
    assert len(parse_features(data)) <= 16
    message = parse_indication(data)
    if isinstance(message, Reply):
        assert message.status_text
    settings = parse_settings(data)
    assert sum(len(values) for values in settings.values()) <= len(data)
    for measurement in Measurement:
        assert len(start(measurement, choose(settings, {Setting.SAMPLE_RATE: 50}))) <= 2 + 5 * 6
