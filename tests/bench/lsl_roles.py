"""LSL's two ends: ``python -m tests.bench.lsl_roles send|receive COUNT TIMES_FILE``."""

from __future__ import annotations

import sys
from pathlib import Path

import pylsl

from tests.bench.roles import CHANNELS, RATE_HZ, Arrivals, send_on_schedule, told_by_parent

NAME, CONTENT_TYPE = "bench", "EEG"
_RESOLVE_S = 30.0
_PULL_S = 0.2


def send(count: int, times_file: Path) -> None:
    """Offer the stream and push sample by sample."""
    info = pylsl.StreamInfo(NAME, CONTENT_TYPE, CHANNELS, RATE_HZ, "float32", NAME)
    outlet = pylsl.StreamOutlet(info)
    send_on_schedule(list[float], outlet.push_sample, count, times_file)


def receive(count: int, times_file: Path) -> None:
    """Pull with a call that blocks until the next sample."""
    told, arrivals = told_by_parent(), Arrivals(count)
    (info, *_) = pylsl.resolve_byprop("name", NAME, timeout=_RESOLVE_S)
    inlet = pylsl.StreamInlet(info, recover=False)
    while not told.is_set():
        sample, _stamp = inlet.pull_sample(_PULL_S)
        if sample is not None:
            arrivals.add(sample[0])
    arrivals.write(times_file)


if __name__ == "__main__":
    {"send": send, "receive": receive}[sys.argv[1]](int(sys.argv[2]), Path(sys.argv[3]))
