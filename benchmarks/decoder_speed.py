"""How fast every decoder is, on what its driver fed it from a virtual device.

Each driver runs against its virtual device for some seconds while the calls of its decoder are
taped; then the tape is played to a new decoder, as fast as it goes. A sensor takes part that has a
file ``taped.json`` in the folder of its tests, which says what its decoder is, as a `Taped`.
"""

from __future__ import annotations

import asyncio
import json
import statistics
from dataclasses import dataclass
from pathlib import Path

from benchmarks.tape import Tape, Taped, taping
from biosensor_gateway.demo.virtual_devices import simulated_settings
from biosensor_gateway.doctor import device_test

_TESTS = Path(__file__).parents[1] / "tests"
SENSORS = tuple(sorted(path.parent.name for path in _TESTS.glob("*/taped.json")))


@dataclass(slots=True)
class DecoderSpeed:
    """Speed of one sensor's decoder, as multiples of real time."""

    sensor: str
    taped_s: float
    best: float
    median: float


def measure(passes: int, taped_s: float) -> list[DecoderSpeed]:
    """Tape each decoder for so long, then play its tape so many times."""
    return [_measure(sensor, passes, taped_s) for sensor in SENSORS]


def _measure(sensor: str, passes: int, taped_s: float) -> DecoderSpeed:
    tape = Tape()
    taped = Taped(**json.loads((_TESTS / sensor / "taped.json").read_text("utf-8")))
    with taping(taped, tape), simulated_settings([sensor]) as settings:
        outcome = asyncio.run(device_test.run_device_test(settings.devices[0], taped_s))
    assert outcome.info is not None, outcome.problems
    multiples = [taped_s / tape.play() for _ in range(passes)]
    return DecoderSpeed(sensor, taped_s, max(multiples), statistics.median(multiples))
