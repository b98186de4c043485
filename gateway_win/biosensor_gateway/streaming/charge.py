"""Keeps what a device last said of its battery."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from biosensor_common.quantities import ChannelRole
from biosensor_common.spec import SensorSpec


class Charge:
    """Follows the first channel of one device that has the role of state of charge.

    Attributes
    ----------
    percent
        Newest value; None before the first.
    """

    def __init__(self, spec: SensorSpec) -> None:
        first = next(spec.channels_of(ChannelRole.STATE_OF_CHARGE), ("", 0, ""))
        self._data_name, self._index, _ = first
        self.percent: float | None = None

    def sampled(self, data_name: str, samples: ArrayLike, stamps: Sequence[float]) -> None:
        """Take in samples of any stream of the device; NaN says nothing.

        Parameters
        ----------
        samples : array_like, shape (n_samples, n_channels) or (n_samples,)
        stamps : sequence of float, length n_samples
        """
        if data_name != self._data_name:
            return
        values = np.asarray(samples, np.float64).reshape(len(stamps), -1)[:, self._index]
        known = values[np.isfinite(values)]
        if known.size:
            self.percent = float(known[-1])
