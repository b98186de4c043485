"""The virtual optical sensors speak as published: byte by byte, and through plain bleak."""

from __future__ import annotations

import pytest

from biosensor_gateway.devices.polar_h10.simulator.pmd_service import ControlPoint
from biosensor_gateway.devices.polar_verity_sense.simulator import (
    VERITY_SENSE,
)

START_ACC = "02 02 00 01 34 00 01 01 10 00 02 01 08 00 04 01 03"
START_PPG = "02 01 00 01 37 00 01 01 16 00 04 01 04"
FULL_MTU = 232


def ask(point: ControlPoint, command: str, mtu: int = FULL_MTU) -> str:
    return " ".join(packet.hex() for packet in point.answer(bytes.fromhex(command), mtu))


def spaced(text: str) -> str:
    return text.replace(" ", "").lower()


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        ("0102", "F0 01 02 00 00 00 01 34 00 01 01 10 00 02 01 08 00 04 01 03"),
        ("0105", "F0 01 05 00 00 00 01 34 00 01 01 10 00 02 01 D0 07 04 01 03"),
        (START_ACC, "F0 02 02 00 00 05 01 40 DA 7F 39"),
        (START_PPG, "F0 02 01 00 00"),
        ("0203", "F0 02 03 00 00"),
        ("0209", "F0 02 09 00 00"),
        ("06", "F0 06 00 00 00 00"),
    ],
)
def test_a_verity_sense_answers_as_published(command: str, reply: str) -> None:
    assert ask(ControlPoint(VERITY_SENSE), command) == spaced(reply)


def test_sdk_mode_needs_silence_and_can_be_asked_for() -> None:
    point = ControlPoint(VERITY_SENSE)
    ask(point, "0203")
    assert ask(point, "0209") == "f002090c00"
    ask(point, "0303")
    assert ask(point, "0209") == "f002090000"
    assert ask(point, "06") == "f00600000001"
    # No intervals in this mode, and it cannot be left before all is silent.
    assert ask(point, "0203") == "f002030300"
    ask(point, START_PPG)
    assert ask(point, "0309") == "f003090c00"
    ask(point, "0301")
    assert ask(point, "0309") == "f003090000"
    assert ask(point, "06") == "f00600000000"


def test_the_settings_of_the_sdk_mode_can_be_asked_for_in_any() -> None:
    point = ControlPoint(VERITY_SENSE)
    wide = ask(point, "0402")
    assert wide[:4] == "f004"
    ask(point, "0209")
    assert ask(point, "0102")[4:] == wide[4:]
