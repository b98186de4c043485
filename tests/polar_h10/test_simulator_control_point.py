"""The virtual sensor's control point, byte by byte, without its radio."""

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.polar_h10.simulator.pmd_service import ControlPoint
from biosensor_gateway.devices.polar_h10.simulator.products import H10

FOLDER = Path(__file__).parent / "vectors"
VECTORS: dict[str, dict[str, Any]] = {
    vector["name"]: vector
    for name in ("polar_pmd_h10.json", "polar_pmd_verity.json")
    for vector in json.loads((FOLDER / name).read_text())
}
START_ECG = "02 00 00 01 82 00 01 01 0e 00"
START_ACC_H10 = "02 02 02 01 08 00 00 01 c8 00 01 01 10 00"
FULL_MTU = 232


def ask(point: ControlPoint, command: str, mtu: int = FULL_MTU) -> str:
    return " ".join(packet.hex() for packet in point.answer(bytes.fromhex(command), mtu))


def spaced(text: str) -> str:
    return text.replace(" ", "").lower()


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        ("0100", "F0 01 00 00 00 00 01 82 00 01 01 0E 00"),
        (
            "0102",
            "F0 01 02 00 00 00 04 19 00 32 00 64 00 C8 00 01 01 10 00 02 03 02 00 04 00 08 00",
        ),
        (START_ECG, "F0 02 00 00 00"),
        (START_ACC_H10, "F0 02 02 00 00 01"),
        ("02 02 00 01 19 00 01 01 10 00 02 01 02 00", "F0 02 02 00 00 01"),
        ("05", "F0 05 00 00 00 00 02"),
    ],
)
def test_an_h10_answers_as_published(command: str, reply: str) -> None:
    assert ask(ControlPoint(H10), command) == spaced(reply)


@pytest.mark.parametrize(
    ("vector", "commands", "short_errors", "minimum_mtu"),
    [
        ("settings_ecg", ["cmd_get_ecg_settings"], False, 0),
        ("settings_acc", ["cmd_get_acc_settings"], False, 0),
        ("start_ecg_ok", ["cmd_start_ecg_130_14"], False, 0),
        ("stop_ecg_ok", ["cmd_start_ecg_130_14", "cmd_stop_ecg"], False, 0),
        ("err_already_in_state", ["cmd_start_ecg_130_14"] * 2, False, 0),
        ("err_already_in_state_4byte", ["cmd_start_ecg_130_14"] * 2, True, 0),
        ("err_not_supported_sdkmode_on_h10", ["cmd_start_sdk_mode"], True, 0),
        ("err_invalid_mtu", ["cmd_start_ecg_130_14"], False, 500),
    ],
)
def test_it_writes_the_vectors(
    vector: str, commands: list[str], short_errors: bool, minimum_mtu: int
) -> None:
    point = ControlPoint(H10, short_errors=short_errors, minimum_mtu=minimum_mtu)
    replies = [ask(point, VECTORS[command]["hex"]) for command in commands]
    assert replies[-1] == VECTORS[vector]["hex"]


@pytest.mark.parametrize(
    ("command", "status"),
    [
        ("", 1),
        ("09 00", 1),
        ("02", 4),
        ("02 63", 2),
        ("02 01", 3),
        ("02 09", 3),
        ("04 02", 3),
        ("06", 3),
        ("01 00 00", 4),
        ("02 80 00 01 82 00 01 01 0e 00", 2),
        ("02 00", 5),
        ("02 00 00 01 82 00", 5),
        ("02 00 00 01 82 00 01 01", 4),
        ("02 00 00 02 82 00 82 00 01 01 0e 00", 5),
        ("02 00 00 01 82 00 00 01 82 00 01 01 0e 00", 5),
        ("02 00 00 01 82 00 01 01 0e 00 02 01 02 00", 5),
        ("02 00 63 01 00", 5),
        ("02 00 00 01 83 00 01 01 0e 00", 8),
        ("02 00 00 01 82 00 01 01 10 00", 7),
        ("02 02 02 01 03 00 00 01 c8 00 01 01 10 00", 9),
        ("03", 4),
        ("03 00", 6),
        ("03 00 00", 4),
    ],
)
def test_a_wrong_command_is_refused_without_effect(command: str, status: int) -> None:
    point = ControlPoint(H10)
    (reply,) = point.answer(bytes.fromhex(command), FULL_MTU)
    assert reply == b"\xf0" + bytes.fromhex(command)[:2].ljust(2, b"\0") + bytes((status, 0))
    assert point.running == {}


@given(st.lists(st.binary(max_size=24), max_size=8))
def test_whatever_it_hears_it_answers(commands: list[bytes]) -> None:
    point = ControlPoint(H10)
    for command in commands:
        packets = point.answer(command, FULL_MTU)
        assert packets
        assert all(packet[0] in (0xF0, 0x01) for packet in packets)
