"""How fast every decoder is, on what its driver fed it from a virtual device.

Each driver runs against its virtual device for some seconds while the calls of its decoder are
taped; then the tape is played to a new decoder, as fast as it goes. A sensor takes part that has a
module ``taped`` in the folder of its tests, whose ``TAPED`` says what its decoder is.
"""

from __future__ import annotations

import asyncio
import statistics
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from benchmarks.tape import Tape, Taped, taping
from biosensor_gateway.demo.virtual_devices import simulated_settings
from biosensor_gateway.doctor import device_test

_TESTS = Path(__file__).parents[1] / "tests"
SENSORS = tuple(sorted(path.parent.name for path in _TESTS.glob("*/taped.py")))


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
    tape, taped = Tape(), import_module(f"tests.{sensor}.taped").TAPED
    assert isinstance(taped, Taped)
    with taping(taped, tape), simulated_settings([sensor]) as settings:
        outcome = asyncio.run(device_test.run_device_test(settings.devices[0], taped_s))
    assert outcome.info is not None, outcome.problems
    multiples = [taped_s / tape.play() for _ in range(passes)]
    return DecoderSpeed(sensor, taped_s, max(multiples), statistics.median(multiples))
