"""Tells from a contact channel when a sensor is put on and taken off."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike

from biosensor_common.quantities import ChannelRole
from biosensor_common.spec import SensorSpec


class ContactWatch:
    """Follows the first channel of one device that has the role of contact.

    Attributes
    ----------
    channel
        Its label, empty for a sensor that has none.
    is_on
        Whether it is on the body; None while that is not known.
    """

    def __init__(self, spec: SensorSpec) -> None:
        first = next(spec.channels_of(ChannelRole.CONTACT), ("", 0, ""))
        self._data_name, self._index, self.channel = first
        self.is_on: bool | None = None

    def forget(self) -> None:
        """Take the next value as news, whatever it is."""
        self.is_on = None

    def changes(
        self, data_name: str, samples: ArrayLike, stamps: Sequence[float]
    ) -> Iterator[tuple[bool, float]]:
        """Yield whether it is on the body, and since when, each time that this changes.

        Parameters
        ----------
        data_name
            Of any stream of the device.
        samples : array_like, shape (n_samples, n_channels) or (n_samples,)
        stamps : sequence of float, length n_samples
        """
        if data_name != self._data_name:
            return
        values = np.asarray(samples, np.float64).reshape(len(stamps), -1)[:, self._index]
        for value, stamp in zip(values.tolist(), stamps, strict=True):
            # NaN is unknown.
            if not math.isnan(value) and bool(value) != self.is_on:
                self.is_on = bool(value)
                yield self.is_on, stamp
