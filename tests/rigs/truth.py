"""What came from a virtual device, held against what it measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.simulation.virtual_device import VirtualDevice
from biosensor_gateway.system.clock import LSL_CLOCK
from tests.rigs.driver_run import NotedSink

Floats = NDArray[np.float64]


def assert_once_and_in_order(part: list[list[float]], whole: Floats) -> list[int]:
    """Assert that all samples are the device's, each once; return where they lie."""
    received = np.asarray(part, np.float64)
    places: list[int] = []
    begin = 0
    while len(places) < len(received):
        rest = received[len(places) :]
        begin = _place(rest, whole, begin)
        assert begin >= 0, "what was emitted is no part of what was sent"
        count = _same(rest, whole[begin:])
        places += range(begin, begin + count)
        begin += count
    return places


def assert_only_gaps(
    device: VirtualDevice,
    sink: NotedSink,
    *data_names: str,
    near_s: float = 0.5,
    latest_s: float = 3.0,
) -> list[int]:
    """Assert that what arrived was sent, came once and in order, and is stamped about right.

    Parameters
    ----------
    latest_s
        The limit in real time, where whatever else the machine does may hold up a packet that
        begins a connection.

    Returns
    -------
    list of int
        Which samples of the last stream arrived.
    """
    places: list[int] = []
    is_real = device.world.clock is LSL_CLOCK
    for name in data_names:
        truth = device.truth.samples(name)
        places = assert_once_and_in_order(sink.rows[name], truth.values)
        times = np.array(sink.times[name])
        assert np.all(np.diff(times) > 0)
        errors = times - truth.times[places]
        assert np.min(errors, initial=0.0) > -near_s
        assert np.max(errors, initial=0.0) < (latest_s if is_real else near_s)
    return places


def _place(rest: Floats, whole: Floats, begin: int) -> int:
    """Return where the next samples lie, not before `begin`; -1 if nowhere."""
    # Values repeat; five in a row do not. Between two losses there may be fewer.
    for enough in range(min(5, len(rest)), 0, -1):
        for k in range(begin, len(whole)):
            if _same(rest[:enough], whole[k : k + enough]) >= enough:
                return k
    return -1


def _same(received: Floats, sent: Floats) -> int:
    """Count how many samples are equal, from the first one on."""
    count = min(len(received), len(sent))
    differ = ~np.all(np.isclose(received[:count], sent[:count], rtol=1e-6, equal_nan=True), axis=1)
    return int(np.argmax(differ)) if differ.any() else count
