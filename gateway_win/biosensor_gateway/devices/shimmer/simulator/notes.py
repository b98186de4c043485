"""Notes in a truth what the samples of a virtual Shimmer hold."""

from __future__ import annotations

import numpy as np

from biosensor_gateway.devices.shimmer.simulator.streaming import Sample
from biosensor_gateway.simulation.truth import Truth

_AT_CHANGES = "quality"


class Notes:
    """Writes samples into a truth: each of them, and ``quality`` at each change.

    Parameters
    ----------
    truth
    """

    def __init__(self, truth: Truth) -> None:
        self._truth = truth
        self._quality: tuple[float, ...] = ()

    def sent(self, sample: Sample) -> None:
        """Note a sample that left."""
        for name, values in sample.values.items():
            if name != _AT_CHANGES:
                self._truth.sent(name, [sample.measured_s], [values])
            elif not np.array_equal(values, self._quality, equal_nan=True):
                self._quality = values
                self._truth.sent(name, [sample.measured_s], [values])

    def kept_back(self, sample: Sample) -> None:
        """Note a sample that was measured and never left."""
        for name in sample.values.keys() - {_AT_CHANGES}:
            self._truth.unsent(name, 1)
