"""Streams that come and go: ``python -m benchmarks.churn_outlets STREAMS PERIOD_S``.

Every period the next stream in the rotation starts or, if it runs, stops; then ``step``
is said. A rotation is over when each has come and gone.
"""

from __future__ import annotations

import sys
import time

import pylsl

from benchmarks.child import Orders, say
from benchmarks.samples import CHANNELS, CONTENT_TYPE, FILLER, stream_names, values_of
from biosensor_common.lsl.outlet import LslOutlet

RATE_HZ = 64.0


class Rotation:
    """The streams, of which some run."""

    def __init__(self, streams: int) -> None:
        self._names = stream_names(streams)
        self._running: dict[str, LslOutlet] = {}
        self._step = 0

    def step(self) -> None:
        """Start or stop the next stream."""
        name = self._names[self._step % len(self._names)]
        self._step += 1
        # Dropping the only reference closes the outlet.
        if self._running.pop(name, None) is None:
            info = pylsl.StreamInfo(name, CONTENT_TYPE, CHANNELS, RATE_HZ, "float32", name)
            self._running[name] = LslOutlet(info)

    def push(self, values: list[float]) -> None:
        """Push a sample on every stream that runs."""
        for outlet in self._running.values():
            outlet.push_sample(values)


def send(streams: int, period_s: float) -> None:
    """Send until the parent closes the pipe."""
    orders, rotation, values = Orders(), Rotation(streams), values_of(FILLER)
    due = time.monotonic()
    while not orders.closed.is_set():
        rotation.step()
        say("step")
        for _ in range(round(period_s * RATE_HZ)):
            due += 1 / RATE_HZ
            time.sleep(max(0.0, due - time.monotonic()))
            rotation.push(values)


if __name__ == "__main__":
    send(int(sys.argv[1]), float(sys.argv[2]))
