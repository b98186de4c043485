"""What a subscriber on a robot gets of a stream, with the time of each sample.

The node is the one that colcon has installed, and the subscriber another process.
"""

from __future__ import annotations

import itertools
import math
import struct
import time
from collections.abc import Callable
from typing import Any

import pylsl
import pytest

from tests.system.programs import Program
from tests.system.tracks import NS_PER_S, Sample, samples_of, system_minus_lsl_ns
from tests.system.workspace import Workspace

pytestmark = pytest.mark.system

TOPIC = "/biosensors/bench/EEG_stamped"
CHANNELS = 4
RATE_HZ = 100.0
SAMPLES = 400
DEADLINE_S = 30.0
TOLERANCE_NS = 1_000_000
# Samples pushed at once, again and again, so that messages differ in length.
PIECES = (1, 2, 5, 1, 12)


class Source:
    """The foreign LSL stream ``bench``; its samples and their stamps follow from their numbers."""

    def __init__(self) -> None:
        info = pylsl.StreamInfo("bench", "EEG", CHANNELS, RATE_HZ, "float32", "bench-stamped")
        self._outlet = pylsl.StreamOutlet(info)
        self._start = pylsl.local_clock()
        self._pieces = itertools.cycle(PIECES)
        self.pushed = 0

    def stamp(self, number: int) -> float:
        """LSL time of a sample; the intervals are uneven, by less than half of one."""
        return self._start + number / RATE_HZ + 0.003 * math.sin(number)

    @staticmethod
    def values(number: int) -> tuple[float, ...]:
        """Values of a sample, as a float32 holds them; each seventh misses one."""
        missing = number % 7 == 0
        row = (number, number + 0.1, -number / 3, math.nan if missing else 1e-7 * number)
        return struct.unpack(f"{CHANNELS}f", struct.pack(f"{CHANNELS}f", *row))

    def push_until(self, enough: Callable[[], bool]) -> None:
        """Push pieces, each when its last sample is due."""
        while not enough():
            numbers = range(self.pushed, self.pushed + next(self._pieces))
            time.sleep(max(0.0, self.stamp(numbers[-1]) - pylsl.local_clock()))
            self._outlet.push_chunk(
                [list(self.values(number)) for number in numbers],
                [self.stamp(number) for number in numbers],
            )
            self.pushed = numbers.stop


def _wait_for(subscriber: Program, number: int) -> None:
    """Wait until the subscriber has the sample of that number, or for the deadline."""
    end = time.monotonic() + DEADLINE_S
    while time.monotonic() < end:
        messages = subscriber.records
        if messages and messages[-1]["data"][-CHANNELS] == number:
            return
        time.sleep(0.1)


@pytest.mark.seam
def test_a_subscriber_gets_stamped_samples(
    workspace: Workspace, start: Callable[..., Program]
) -> None:
    environment = workspace.environment()
    listen = workspace.program("tests.system.subscriber", "biosensor_msgs/msg/Samples", TOPIC)
    subscriber = start("subscriber", listen, env=environment)
    node = start("node", [workspace.node], env=environment)
    source = Source()
    deadline = time.monotonic() + DEADLINE_S
    source.push_until(lambda: bool(subscriber.records) or time.monotonic() > deadline)
    assert subscriber.records, f"nothing came:\n{subscriber.output}{node.output}"
    last = source.pushed + SAMPLES
    source.push_until(lambda: source.pushed > last)
    _wait_for(subscriber, source.pushed - 1)
    messages = subscriber.records
    _check_messages(messages)
    _check_samples(samples_of(messages), source)
    assert node.process.poll() is None, node.output


def _check_messages(messages: list[dict[str, Any]]) -> None:
    for message in messages:
        assert message["header"]["frame_id"] == "bench"
        assert (len(message["labels"]), len(message["units"])) == (CHANNELS, CHANNELS)
        assert message["integers"] == []
        # All came, and a foreign stream is counted by its stamps.
        assert (message["lost"], message["lost_is_estimated"]) == (0, True)


def _check_samples(samples: list[Sample], source: Source) -> None:
    """Every sample since the first is there, once, in order, with its values and its time."""
    numbers = range(round(samples[0].values[0]), source.pushed)
    assert len(numbers) >= SAMPLES
    # As text NaN equals itself.
    expected = [repr(source.values(number)) for number in numbers]
    assert [repr(sample.values) for sample in samples] == expected
    first = samples[0].sequence
    assert [sample.sequence for sample in samples] == list(range(first, first + len(numbers)))
    offset_ns = system_minus_lsl_ns()
    errors_ns = [
        sample.time_ns - round(source.stamp(number) * NS_PER_S) - offset_ns
        for number, sample in zip(numbers, samples, strict=True)
    ]
    assert max(map(abs, errors_ns)) <= TOLERANCE_NS
