"""Divides a run of a stream into data records: their length, and the ranges of its channels."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from biosensor_common.quantities import Unit

LEAST, GREATEST = -(1 << 23), (1 << 23) - 1
"""Of a sample, in 24 bits."""

RATES_HZ = (1e-3, 1e6)
"""Lowest and highest rate that makes sense, and that a header can say."""

_FIELD = 8
# A damaged header may claim a rate that would make one record larger than the memory.
_SHORT = 10_000
"""Characters that a number has in the header."""
_DIMENSIONS: dict[str, str] = {
    Unit.MICROVOLTS: "uV",
    Unit.MILLIVOLTS: "mV",
    Unit.MICROSIEMENS: "uS",
    Unit.CELSIUS: "degC",
    Unit.NONE: "",
}
_IN_MICROVOLTS = {"V": 1e6, "volts": 1e6, "volt": 1e6}


class Channel(NamedTuple):
    """One channel of a file.

    Attributes
    ----------
    place
        Its place in the stream.
    factor
        By which its values are multiplied to be in `dimension`.
    least, greatest
        Of the values in `dimension`, as the header can say them.
    """

    place: int
    label: str
    dimension: str
    factor: float
    least: float
    greatest: float

    @property
    def step(self) -> float:
        """What one digital step is in `dimension`."""
        return (self.greatest - self.least) / (GREATEST - LEAST)


@dataclass(frozen=True, slots=True)
class Layout:
    """Of the data records of one file.

    Attributes
    ----------
    samples
        Of each channel in a record.
    record_s
        How long a record is, as the header can say it.
    records
        How many.
    """

    samples: int
    record_s: float
    records: int

    @property
    def rate_hz(self) -> float:
        """The rate that a reader makes of it."""
        return self.samples / self.record_s


def layout(count: int, rate_hz: float) -> Layout:
    """Return records of about a second for so many samples at a rate, which need not be whole.

    Parameters
    ----------
    rate_hz
        In `RATES_HZ`.
    """
    samples = max(1, min(round(rate_hz), max(count, _SHORT)))
    length_s = samples / rate_hz
    decimals = max(0, _FIELD - 1 - len(str(int(length_s))))
    return Layout(samples, round(length_s, decimals), math.ceil(count / samples))


def channel(place: int, label: str, unit: str, least: float, greatest: float) -> Channel | None:
    """Return how a channel is written; None if its values do not fit into the header.

    Parameters
    ----------
    least, greatest
        Of its values; infinite if it has none.
    """
    factor = _IN_MICROVOLTS.get(unit, 1.0)
    dimension = "uV" if unit in _IN_MICROVOLTS else _DIMENSIONS.get(unit, unit)
    if not least <= greatest:
        least = greatest = 0.0
    low, high = _outward(least * factor, math.floor), _outward(greatest * factor, math.ceil)
    if low is None or high is None:
        return None
    if low == high:
        high = low + 1
    text = "".join(char for char in dimension if " " <= char <= "~")[:_FIELD]
    return Channel(place, label, text, factor, low, high)


def _outward(value: float, rounded: Callable[[float], int]) -> float | None:
    """Return the next number outwards that has at most 8 characters."""
    for decimals in range(_FIELD - 2, -1, -1):
        scale = 10**decimals
        if not math.isfinite(value * scale):
            continue  # nothing is dropped: with fewer decimals it may be written
        found = rounded(value * scale) / scale
        if len(f"{found:.{decimals}f}") <= _FIELD:
            return found
    return None
