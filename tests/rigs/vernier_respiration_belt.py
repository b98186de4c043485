"""What came from a virtual belt, held against what it measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.devices.vernier_respiration_belt.simulator import SimulatedBelt
from biosensor_gateway.system.clock import LSL_CLOCK
from tests.rigs.driver_run import NotedSink

_NEAR_S = 0.1
# The belt stamps nothing: its first sample is stamped when it arrives. In real time that may be
# late by whatever else the machine does.
_LATEST_S = 2.0


def assert_true(sink: NotedSink, belt: SimulatedBelt) -> NDArray[np.intp]:
    """Compare values and stamps with what the belt measured; return which samples arrived."""
    truth = belt.truth.samples("force")
    index = _places(sink.values("force"), truth.values[:, 0])
    errors = np.asarray(sink.times["force"]) - np.asarray(truth.times)[index]
    assert errors.min() > -_NEAR_S
    assert errors.max() < (_LATEST_S if belt.world.clock is LSL_CLOCK else _NEAR_S)
    rates = belt.truth.samples("bpm").values[index, 0]
    np.testing.assert_array_equal(sink.values("bpm"), rates)
    assert sink.times["bpm"] == sink.times["force"]
    return index


def _places(emitted: Sequence[float], truth: NDArray[np.float64]) -> NDArray[np.intp]:
    """Where each emitted sample is in the truth; every one must be there, once and in order."""
    indices = [int(np.flatnonzero(truth == value)[0]) for value in emitted]
    assert all(np.diff(indices) > 0)
    return np.asarray(indices)
