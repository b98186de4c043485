"""When the shipped recording first fills each stream, as the driver's decoder sees it."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil
from pathlib import Path

import pytest

from biosensor_gateway.devices.zephyr.driver.messages import Message, Summary, Waveform
from biosensor_gateway.devices.zephyr.driver.protocol import ZephyrProtocol
from biosensor_gateway.devices.zephyr.simulator import RecordedZephyr, recording

FOLDER = Path(recording.__file__).parent / "recordings"
NAME = "zephyr_bh3_2012-09-26_150s"
NUMBERS = {"hr": "heart_rate_bpm", "hrv": "hrv_ms", "st": "skin_temperature_c"}


def messages() -> Iterator[tuple[float, Message]]:
    """Yield what the recording says, with the seconds since its first read."""
    data = (FOLDER / f"{NAME}.dat").read_bytes()
    rows = (FOLDER / f"{NAME}-timing.csv").read_text("ascii").split()
    reads = [(float(time), int(total)) for time, total in (row.split(",") for row in rows)]
    protocol, position = ZephyrProtocol(), 0
    for time, total in reads:
        for message in protocol.feed(data[position:total]):
            yield time - reads[0][0], message
        position = total


@pytest.fixture(scope="module")
def first() -> dict[str, float]:
    """Seconds to the first value of each stream that has any."""
    seconds: dict[str, float] = {}
    for time, message in messages():
        names = (
            ["breathing"] if isinstance(message, Waveform) and len(message.samples) == 18 else []
        )
        if isinstance(message, Summary):
            names = [name for name, key in NUMBERS.items() if message.numbers[key] is not None]
        for name in names:
            seconds.setdefault(name, time)
    return seconds


def test_the_demo_waits_for_what_the_recording_says_late(first: dict[str, float]) -> None:
    late = {name: filled.after_s for name, filled in RecordedZephyr.filled.items()}
    assert late == {"hrv": ceil(first["hrv"]), "breathing": ceil(first["breathing"]), "st": None}


def test_the_recorded_device_never_tells_its_temperature(first: dict[str, float]) -> None:
    assert "st" not in first
    assert first["hr"] == 0
