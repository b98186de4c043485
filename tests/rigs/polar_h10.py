"""What came from a virtual Polar sensor, held against what it measured."""

from __future__ import annotations

import numpy as np

from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from tests.rigs.driver_run import NotedSink
from tests.rigs.truth import assert_once_and_in_order

_LATEST_S = 0.5


def assert_only_gaps(h10: SimulatedPolarH10, sink: NotedSink) -> None:
    """Assert that what arrived was sent, came once and in order, and is stamped about right."""
    for name in ("ecg", "acc"):
        truth = h10.truth.samples(name)
        places = assert_once_and_in_order(sink.rows[name], truth.values)
        times = np.array(sink.times[name])
        assert np.all(np.diff(times) > 0)
        assert np.max(np.abs(times - truth.times[places]), initial=0.0) < _LATEST_S
