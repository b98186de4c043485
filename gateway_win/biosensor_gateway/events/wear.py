"""Whether somebody wears a sensor, as far as its ``quality`` stream says."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike

from biosensor_common.spec import SensorSpec

DATA_NAME = "quality"
CHANNELS = ("worn", "contact", "electrodes")
"""Channels that tell it: 1 on the body, 0 off it, NaN unknown."""


class WearWatch:
    """Follows one device's ``quality``.

    Attributes
    ----------
    channel
        Which one tells, empty for a sensor that does not.
    """

    def __init__(self, spec: SensorSpec) -> None:
        labels = [
            channel.label
            for stream in spec.streams
            if stream.data_name == DATA_NAME
            for channel in stream.channels
        ]
        self.channel = next((label for label in labels if label in CHANNELS), "")
        self._index = labels.index(self.channel) if self.channel else 0
        self._is_on: bool | None = None

    def forget(self) -> None:
        """Take the next value as news, whatever it is."""
        self._is_on = None

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
        if not self.channel or data_name != DATA_NAME:
            return
        values = np.asarray(samples, np.float64).reshape(len(stamps), -1)[:, self._index]
        for value, stamp in zip(values.tolist(), stamps, strict=True):
            if value == value and bool(value) != self._is_on:  # noqa: PLR0124 - NaN is unknown
                self._is_on = bool(value)
                yield self._is_on, stamp
