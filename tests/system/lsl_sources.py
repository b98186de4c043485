"""LSL streams of other programs, in every format, and a button of ours.

The values and stamps of a sample follow from its number.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import pylsl

from biosensor_common import naming
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet
from tests.system.tracks import NS_PER_S, Track

PERIOD_S = 0.04
# Every so many samples a channel has no value.
MISSING_EACH = 7
BUTTON_RATE_HZ = 1.3


class Spec(NamedTuple):
    """A stream of another program."""

    name: str
    content_type: str
    format: str
    channels: int
    rate: float  # In Hz; of an irregular stream the mean one.
    piece: int = 1  # Samples that are pushed together, each with a stamp of its own.
    is_regular: bool = True

    @property
    def topic(self) -> str:
        """Of its stamped samples."""
        return f"/biosensors/{self.name}/{self.content_type}_stamped"

    @property
    def source_id(self) -> str:
        return f"test-{self.name}"


SPECS = (
    Spec("headset", "EEG", "float32", 8, 256.0, piece=16),
    Spec("plate", "Force", "double64", 2, 50.0),
    Spec("counter32", "Counts", "int32", 2, 25.0, piece=3),
    Spec("counter16", "Counts", "int16", 3, 25.0),
    Spec("counter8", "Counts", "int8", 2, 25.0, piece=2),
    Spec("counter64", "Counts", "int64", 2, 25.0, piece=2),
    Spec("gaze", "Gaze", "float32", 2, 9.0, piece=4, is_regular=False),
    Spec("notes", "Markers", "string", 1, 4.0, piece=2, is_regular=False),
    Spec("answers", "Markers", "string", 3, 2.0, is_regular=False),
)

BUTTON = DeviceIdentity("empatica_e4", "E4X", participant="p01", label="left")
BUTTON_TOPIC = "/p01/biosensors/empatica_e4_left/tag_stamped"
BUTTON_SOURCE_ID = naming.source_id(BUTTON, "tag")


def row(spec: Spec, number: int) -> list[Any]:
    """Return the values of a sample."""
    if spec.format == "string":
        return [f"{spec.name} {number}.{channel} µV\n\"🫀\"" if number % 5 else ""
                for channel in range(spec.channels)]  # fmt: skip
    if spec.format.startswith("int"):
        # From both ends of what the format holds.
        limits = np.iinfo(spec.format)
        inwards = number % 100
        return [int((limits.min + inwards, limits.max - inwards)[c % 2])
                for c in range(spec.channels)]  # fmt: skip
    values = [number + channel / 3 for channel in range(spec.channels)]
    if number % MISSING_EACH == 0:
        values[-1] = math.nan
    return values


class Source:
    """One stream; what it has pushed follows from `pushed`."""

    def __init__(self, spec: Spec) -> None:
        self.spec = spec
        self.pushed = 0
        rate = spec.rate if spec.is_regular else 0.0
        info = pylsl.StreamInfo(
            spec.name, spec.content_type, spec.channels, rate, spec.format, spec.source_id
        )
        self._outlet = pylsl.StreamOutlet(info)
        self._start_s = pylsl.local_clock()

    def stamp(self, number: int) -> float:
        """LSL time of a sample; no two intervals are alike."""
        return self._start_s + (number + 0.3 * math.sin(number)) / self.spec.rate

    def track(self, system_minus_lsl_ns: int) -> Track:
        """Return all that was pushed; of a stream of 64-bit integers."""
        numbers = range(self.pushed)
        times = [round(self.stamp(number) * NS_PER_S) + system_minus_lsl_ns for number in numbers]
        values = [row(self.spec, number) for number in numbers]
        return Track(np.array(times, np.int64), np.array(values, np.int64))

    def push_due(self) -> None:
        """Push the pieces whose last sample is due."""
        while True:
            numbers = range(self.pushed, self.pushed + self.spec.piece)
            if self.stamp(numbers[-1]) > pylsl.local_clock():
                return
            rows = [row(self.spec, number) for number in numbers]
            self._outlet.push_chunk(rows, [self.stamp(number) for number in numbers])
            self.pushed = numbers.stop


class Button:
    """The button of a wristband, pressed again and again."""

    def __init__(self) -> None:
        self._outlet = Outlet(declaration("empatica_e4").stream("tag"), BUTTON, DeviceInfo())
        self._start_s = pylsl.local_clock()
        self.pressed = 0

    def push_due(self) -> None:
        """Push what is due."""
        stamp = self._start_s + self.pressed / BUTTON_RATE_HZ
        if stamp <= pylsl.local_clock():
            self._outlet.push_text(f"press {self.pressed}", stamp)
            self.pressed += 1


@contextmanager
def running() -> Generator[list[Source]]:
    """Let all streams push until the end of the block."""
    sources = [Source(spec) for spec in SPECS]
    pushing = [*sources, Button()]
    stopping = threading.Event()

    def push() -> None:
        while not stopping.wait(PERIOD_S):
            for each in pushing:
                each.push_due()

    thread = threading.Thread(target=push, daemon=True)
    thread.start()
    try:
        yield sources
    finally:
        stopping.set()
        thread.join()
