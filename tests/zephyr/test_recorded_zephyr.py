"""What the driver makes of the shipped recording, as it is and with its numbers spoilt."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from math import ceil
from pathlib import Path

import pytest

from biosensor_gateway.devices.zephyr.driver.emitter import ZephyrEmitter
from biosensor_gateway.devices.zephyr.driver.messages import (
    Acceleration,
    Message,
    RrIntervals,
    Summary,
    Waveform,
)
from biosensor_gateway.devices.zephyr.driver.protocol import ZephyrProtocol
from biosensor_gateway.devices.zephyr.simulator import RecordedZephyr, recording
from tests.rigs.emitter_sink import EmitterSink

FOLDER = Path(recording.__file__).parent / "recordings"
NAME = "zephyr_bh3_2012-09-26_150s"
NUMBERS = {"hr": "heart_rate_bpm", "hrv": "hrv_ms", "st": "skin_temperature_c"}

Periodic = Waveform | Acceleration | RrIntervals | Summary


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


def twice(number: int, message: Periodic) -> list[Periodic]:
    return [message, message]


def standing_still(number: int, message: Periodic) -> list[Periodic]:
    return [replace(message, header=replace(message.header, sequence=7))]


def begun_again(number: int, message: Periodic) -> list[Periodic]:
    """Number the packets from 0 again, every 20 s or so."""
    sequence = (message.header.sequence + 100 * (number // 200)) % 256
    return [replace(message, header=replace(message.header, sequence=sequence))]


def as_it_is(number: int, message: Periodic) -> list[Periodic]:
    return [message]


def emitted(spoil: Callable[[int, Periodic], list[Periodic]]) -> EmitterSink:
    sink = EmitterSink("zephyr")
    emitter = ZephyrEmitter(sink)
    for number, (time, message) in enumerate(messages()):
        for each in spoil(number, message) if isinstance(message, Periodic) else [message]:
            emitter.take(each, time)
    return sink


@pytest.mark.parametrize("spoil", [twice, standing_still, begun_again])
def test_numbers_that_the_stamps_contradict_change_nothing(
    spoil: Callable[[int, Periodic], list[Periodic]],
) -> None:
    whole, spoilt = emitted(as_it_is), emitted(spoil)
    assert len(whole.values("ecg")) == 597 * 63
    assert (whole.losses, spoilt.losses) == ({}, {})
    assert spoilt.emitted == whole.emitted
    assert spoilt.times == whole.times
