"""Samples from a wristband, and their encoding by the server."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import nan
from typing import NamedTuple

import numpy as np

from biosensor_gateway.system.clock import Clock

_VALUE_DIGITS = 7
_STAMP_DIGITS = 15


@dataclass(frozen=True, slots=True)
class NumberFormat:
    """The number format of a locale."""

    decimal_mark: str = ","  # `,` or `.`.
    minus_sign: str = "-"  # `-`, or U+2212 in some locales.
    digits: str = "0123456789"  # Digits from 0 to 9.

    def value(self, number: float) -> str:
        """Format a measured value: single precision, G7."""
        return self._localised(f"{as_sent(number):.{_VALUE_DIGITS}g}")

    def stamp(self, unix_s: float) -> str:
        """Format a time: double precision, G15, with a resolution of 10 us."""
        return self._localised(f"{unix_s:.{_STAMP_DIGITS}g}")

    def with_other_mark(self) -> NumberFormat:
        """Return the format of a locale with the other decimal mark."""
        return replace(self, decimal_mark="." if self.decimal_mark == "," else ",")

    def _localised(self, text: str) -> str:
        marked = text.upper().replace(".", self.decimal_mark).replace("-", self.minus_sign)
        return marked.translate(str.maketrans("0123456789", self.digits))


def as_sent(number: float) -> float:
    """Round a value to the precision of `NumberFormat.value`; never -0."""
    return float(f"{float(np.float32(number)):.{_VALUE_DIGITS}g}") + 0.0


COUNTS_PER_G = 64


class Stream(NamedTuple):
    """One stream of the server."""

    word: str  # First word of its lines.
    subscription: str  # Word that clients subscribe to.
    data_name: str
    # Nominal rate for the server's timestamps; None for samples with their own time.
    rate_hz: float | None
    # Converts sent values to declared units.
    declared: Callable[[Sequence[float]], tuple[float, ...]]


def _conductance(values: Sequence[float]) -> tuple[float, ...]:
    return (nan if values[0] == 0 else values[0],)


def _acceleration(values: Sequence[float]) -> tuple[float, ...]:
    return tuple(value / COUNTS_PER_G for value in values)


def _charge(values: Sequence[float]) -> tuple[float, ...]:
    return (values[0] * 100,)


BVP = Stream("E4_Bvp", "bvp", "bvp", 63.997, tuple)
ACC = Stream("E4_Acc", "acc", "acc", 32, _acceleration)
GSR = Stream("E4_Gsr", "gsr", "gsr", 4, _conductance)
TEMPERATURE = Stream("E4_Temperature", "tmp", "st", 4, tuple)
HR = Stream("E4_Hr", "ibi", "hr", None, tuple)
IBI = Stream("E4_Ibi", "ibi", "ibi", None, tuple)
BATTERY = Stream("E4_Battery", "bat", "bat", None, _charge)
TAG = Stream("E4_Tag", "tag", "tag", None, tuple)
SUBSCRIPTIONS = frozenset({"acc", "bvp", "gsr", "ibi", "tmp", "bat", "tag"})


class Sample(NamedTuple):
    """One sample."""

    stream: Stream
    measured_s: float  # True time [s, LSL clock].
    after_s: float  # Seconds of the wristband's oscillator since the start of its radio link.
    values: tuple[float, ...]  # Values as sent, with the precision of the format.

    @property
    def declared_values(self) -> tuple[float, ...]:
        """Values in the units of the declaration."""
        return self.stream.declared(self.values)

    def line(self, stamp_s: float, style: NumberFormat) -> bytes:
        """Return the sample's line with its line end."""
        numbers = (style.value(value) for value in self.values)
        return (" ".join((self.stream.word, style.stamp(stamp_s), *numbers)) + "\r\n").encode()


@dataclass(frozen=True, slots=True, order=True)
class Packet:
    """Samples sent together; packets are ordered by arrival at the server."""

    arrives_s: float  # Arrival on the LSL clock.
    number: int  # Breaks ties between packets that arrive together.
    # Samples of one subscription, in the order of their lines.
    samples: tuple[Sample, ...] = field(compare=False)

    @property
    def subscription(self) -> str:
        """Word that clients subscribe to."""
        return self.samples[0].stream.subscription


class WallClock:
    """Unix time on the server's PC."""

    def __init__(self, lsl: Clock) -> None:
        self.lsl = lsl
        self._ahead_s = time.time() - lsl()

    def at(self, lsl_s: float) -> float:
        """Return the Unix time at an LSL time."""
        return lsl_s + self._ahead_s

    def jump(self, seconds: float) -> None:
        """Set the clock forward or back."""
        self._ahead_s += seconds


class Stamps:
    """Timestamps of one radio link.

    A timestamp is the first packet's arrival plus the sample's number divided by the nominal rate.
    Lost samples are not numbered, so later timestamps are too early.
    """

    def __init__(self, clock: WallClock) -> None:
        self._clock = clock
        self._reference_s: float | None = None
        self._numbers: Counter[str] = Counter()

    def stamp(self, sample: Sample, arrives_s: float) -> float:
        """Return the timestamp of a sample that arrives now; call this once per sample."""
        if self._reference_s is None:
            self._reference_s = self._clock.at(arrives_s)
        rate_hz = sample.stream.rate_hz
        if rate_hz is None:
            return self._reference_s + sample.after_s
        number = self._numbers[sample.stream.word]
        self._numbers[sample.stream.word] += 1
        return self._reference_s + number / rate_hz

    def jump(self, seconds: float) -> None:
        """Move the reference with the clock."""
        if self._reference_s is not None:
            self._reference_s += seconds
