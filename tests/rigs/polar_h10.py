"""A virtual Polar sensor, as plain bleak reads it and held against what it measured."""

from __future__ import annotations

import numpy as np

from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.system.clock import LSL_CLOCK
from tests.rigs.driver_run import NotedSink
from tests.rigs.truth import assert_once_and_in_order

# What came from a virtual Polar sensor, held against what it measured.

_NEAR_S = 0.5
# In real time, a packet that begins a connection may be held up by whatever else the machine does.
_LATEST_S = 3.0


def assert_only_gaps(h10: SimulatedPolarH10, sink: NotedSink) -> None:
    """Assert that what arrived was sent, came once and in order, and is stamped about right."""
    for name in ("ecg", "acc"):
        truth = h10.truth.samples(name)
        places = assert_once_and_in_order(sink.rows[name], truth.values)
        times = np.array(sink.times[name])
        assert np.all(np.diff(times) > 0)
        errors = times - truth.times[places]
        assert np.min(errors, initial=0.0) > -_NEAR_S
        latest_s = _LATEST_S if h10.world.clock is LSL_CLOCK else _NEAR_S
        assert np.max(errors, initial=0.0) < latest_s
