"""What every measuring process does: say when it is ready, wait for a word, write times down.

A sample carries its number in channel 0. Sender and receiver each keep a list of
times by number, which the parent joins: so no stamp has to survive float32.
``time.monotonic`` is one clock for all processes of a Linux machine.
"""

from __future__ import annotations

import sys
import threading
import time
from array import array
from collections.abc import Callable
from math import nan
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")

CHANNELS = 8
RATE_HZ = 256.0
# Number of the samples that are sent until the receiver is known to be connected.
WARM_UP = -1
TOPIC_DEPTH = int(RATE_HZ)


def say(word: str) -> None:
    """Tell the parent."""
    sys.stdout.write(f"{word}\n")
    sys.stdout.flush()


def told_by_parent() -> threading.Event:
    """Return an event that is set when the parent writes a line, or closes the pipe."""
    told = threading.Event()

    def wait() -> None:
        sys.stdin.readline()
        told.set()

    threading.Thread(target=wait, daemon=True).start()
    return told


def values_of(number: int) -> list[float]:
    """Return the sample of that number; the other channels are of no importance."""
    return [float(number), *(0.125 * channel for channel in range(1, CHANNELS))]


def send_on_schedule(
    make: Callable[[list[float]], T], send: Callable[[T], None], count: int, times_file: Path
) -> None:
    """Send warm-up samples until told, then *count* samples; write the times of sending.

    Every sample has its own due time, so a late one does not delay the next. What is
    sent is made before its time is taken.
    """
    told = told_by_parent()
    say("sending")
    begin, step = time.monotonic(), 0
    while not told.is_set():
        step += 1
        _sleep_until(begin + step / RATE_HZ)
        send(make(values_of(WARM_UP)))
    times = array("d")
    for number in range(count):
        sample = make(values_of(number))
        _sleep_until(begin + (step + 1 + number) / RATE_HZ)
        times.append(time.monotonic())
        send(sample)
    times_file.write_bytes(times.tobytes())
    say("sent")
    # The receiver may still be reading.
    sys.stdin.read()


def _sleep_until(due: float) -> None:
    time.sleep(max(0.0, due - time.monotonic()))


class Arrivals:
    """Times of arrival by number, NaN where nothing arrived."""

    def __init__(self, count: int) -> None:
        self._times = array("d", [nan]) * count
        self._is_connected = False

    def add(self, number: float) -> None:
        """Note that a sample is here."""
        now = time.monotonic()
        if number >= 0:
            self._times[int(number)] = now
        elif not self._is_connected:
            self._is_connected = True
            say("connected")

    def write(self, times_file: Path) -> None:
        """Write all times."""
        times_file.write_bytes(self._times.tobytes())
