"""The virtual belt: its firmware against the vectors, and on the air against plain bleak."""

from __future__ import annotations

import json
from collections.abc import Generator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from biosensor_gateway.devices.vernier_respiration_belt.simulator.wire import BeltFirmware
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.world import World

VECTORS: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent / "vectors/vernier_gdxrb.json").read_text(encoding="utf-8")
)
CONVERSATION = [vector for vector in VECTORS if vector["name"].startswith("conv_")]
# Whatever the vendor's numbers are, the notes call these placeholders.
_PLACEHOLDERS = ("get_sensor_info", "get_device_info")


def test_the_firmware_answers_as_in_the_worked_conversation() -> None:
    firmware = BeltFirmware("GDX-RB", "0K2002Z5")
    answers: list[bytes] = []
    for vector in CONVERSATION:
        data = bytes.fromhex(vector["hex"])
        if "_cmd_" in vector["name"]:
            answers = firmware.hear(data)
        elif "_rsp_" in vector["name"]:
            (answer,) = answers
            if any(each in vector["name"] for each in _PLACEHOLDERS):
                assert answer[:6] == data[:6].replace(data[3:4], answer[3:4], 1)
                assert len(answer) == len(data)
            else:
                assert answer == data, vector["name"]
        else:
            assert firmware.pack(np.array([[11.5, np.nan]], np.float32)) == data


@pytest.fixture
def radio(virtual_world: World) -> Generator[Radio]:
    air = Radio(virtual_world)
    with virtual_bluetooth(air):
        yield air
