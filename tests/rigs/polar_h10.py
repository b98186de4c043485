"""What came from a virtual Polar sensor, held against what it measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from tests.rigs.driver_run import NotedSink

Floats = NDArray[np.float64]

_LATEST_S = 0.5


def assert_once_and_in_order(part: list[list[float]], whole: Floats) -> list[int]:
    """Assert that all samples are the device's, each once; return where they lie."""
    received = np.asarray(part, np.float64)
    places: list[int] = []
    begin = 0
    while len(places) < len(received):
        rest = received[len(places) :]
        # Values repeat; five in a row do not.
        enough = min(5, len(rest))
        begin = next((k for k in range(begin, len(whole)) if _same(rest, whole[k:]) >= enough), -1)
        assert begin >= 0, "what was emitted is no part of what was sent"
        count = _same(rest, whole[begin:])
        places += range(begin, begin + count)
        begin += count
    return places


def assert_only_gaps(h10: SimulatedPolarH10, sink: NotedSink) -> None:
    """Assert that what arrived was sent, came once and in order, and is stamped about right."""
    for name in ("ecg", "acc"):
        truth = h10.truth.samples(name)
        places = assert_once_and_in_order(sink.rows[name], truth.values)
        times = np.array(sink.times[name])
        assert np.all(np.diff(times) > 0)
        assert np.max(np.abs(times - truth.times[places]), initial=0.0) < _LATEST_S


def _same(received: Floats, sent: Floats) -> int:
    """Count how many samples are equal, from the first one on."""
    count = min(len(received), len(sent))
    differ = ~np.all(np.isclose(received[:count], sent[:count], rtol=1e-6), axis=1)
    return int(np.argmax(differ)) if differ.any() else count
