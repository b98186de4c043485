"""Splits streams into runs without gaps, filters them, and holds the newest value of a rate."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.features import parameters as at

Array = NDArray[np.float64]
HR_STATE, BR_STATE = "hr_state", "br_state"


class Event(NamedTuple):
    """One sample of a feature."""

    feature: str
    stamp: float  # LSL time of the event that it describes, on the clock of the source.
    values: tuple[float, ...]  # One value per channel of the feature; NaN for no value.


class Stage(Protocol):
    """Computes events of the samples of one run, and is discarded at the end of the run."""

    def take(self, stamps: Array, values: Array) -> list[Event]:
        """Take neighbouring samples, and return the events that they decide.

        Parameters
        ----------
        stamps : ndarray of float64, shape (n,)
            Ascending.
        values : ndarray of float64, shape (n, n_channels)
            Finite.
        """
        ...


class Runs:
    """Passes each run of a stream to a new stage, so that no gap is bridged.

    A run ends at a value that is not finite or impossibly large, at a stamp that does not follow
    the previous ones, or, in a regular stream, at a gap that is long enough to hide a beat. Samples
    of the first two kinds are left out. If stamps step back by more than `STEP_BACK_S`, a run
    begins: the previous stamps were wrong, or the clock was set back. Events that a stage has not
    decided at the end of its run are lost.

    Parameters
    ----------
    rate
        Nominal rate in Hz; 0 for an irregular stream, which has no gaps.
    hole_s
        Longest loss that is not a gap, in s.
    foreign
        Whether the stamps are another program's, which may jitter.

    Attributes
    ----------
    left_out
        Number of samples so far with a stamp that is not finite or does not follow the previous.
    steps_back
        How often stamps stepped back so far that a run began.
    without_value
        Number of samples so far with an infinite or impossibly large value.
    """

    def __init__(
        self, make: Callable[[], Stage], rate: float, *, hole_s: float = 0.0, foreign: bool = False
    ) -> None:
        self._make = make
        self._longest_step = np.inf
        if rate > 0:
            # Half of a period longer, because stamps jitter.
            longest_s = hole_s + at.GAP_PERIODS / rate
            self._longest_step = max(longest_s, foreign * at.FOREIGN_JITTER_S)
        self._stage: Stage | None = None
        self._last = -np.inf
        self.left_out = self.steps_back = self.without_value = 0

    def take(self, stamps: Array, values: Array) -> list[Event]:
        """Take samples in blocks of any size; shapes (n,) and (n, n_channels)."""
        events: list[Event] = []
        if not len(stamps):
            return events  # nothing is dropped: there is nothing
        latest, steps_back = self._latest_before(stamps)
        with np.errstate(invalid="ignore"):
            is_value = (np.abs(values) <= at.LARGEST_VALUE).all(axis=1)
            follows = np.isfinite(stamps) & (stamps > latest)
            is_good = is_value & follows
            begins = is_good & (stamps - latest > self._longest_step)
        begins[steps_back] = is_good[steps_back]
        self.left_out += int(np.count_nonzero(~follows))
        # NaN means "no value" and is not counted.
        wrong = (np.abs(values) > at.LARGEST_VALUE).any(axis=1)
        self.without_value += int(np.count_nonzero(wrong))
        self.steps_back += len(steps_back)
        cuts = np.flatnonzero(begins | (is_good != np.roll(is_good, 1)))
        bounds = sorted({0, *cuts.tolist(), len(stamps)})
        for begin, end in pairwise(bounds):
            if begins[begin] or not is_good[begin]:
                self._stage = None
            if is_good[begin]:
                self._stage = self._stage or self._make()
                events += self._stage.take(stamps[begin:end], values[begin:end])
        self._last = float(np.fmax(latest[-1], stamps[-1]))
        return events

    def _latest_before(self, stamps: Array) -> tuple[Array, list[int]]:
        """Return the latest stamp before each one since the last step back, and the steps back."""
        latest = np.fmax.accumulate(np.concatenate([[self._last], stamps]))[:-1]
        steps_back: list[int] = []
        while True:
            begin = steps_back[-1] + 1 if steps_back else 0
            with np.errstate(invalid="ignore"):
                found = np.flatnonzero(stamps[begin:] < latest[begin:] - at.STEP_BACK_S)
            if not len(found):
                return latest, steps_back
            place = begin + int(found[0])
            steps_back.append(place)
            latest[place] = -np.inf
            latest[place + 1 :] = np.fmax.accumulate(stamps[place:])[:-1]


class Hops:
    """Cuts a run into pieces of equal length, counted from its start.

    All computations then see arrays of the same shape, so that results are equal to the last bit
    however the stream is cut into blocks.
    """

    def __init__(self, length: int) -> None:
        self._length = length
        self._pending: list[tuple[Array, Array]] = []
        self._count = 0

    def take(self, stamps: Array, values: Array) -> Iterator[tuple[Array, Array]]:
        """Take samples, and yield the pieces that are complete."""
        self._pending.append((stamps, values))
        self._count += len(stamps)
        if self._count < self._length:
            return  # nothing is dropped: they wait for more
        all_stamps = np.concatenate([each for each, _ in self._pending])
        all_values = np.concatenate([each for _, each in self._pending])
        done = self._count - self._count % self._length
        self._pending = [(all_stamps[done:], all_values[done:])]
        self._count -= done
        for begin in range(0, done, self._length):
            end = begin + self._length
            # Copies are aligned alike, so that numpy adds in the same order.
            yield all_stamps[begin:end].copy(), all_values[begin:end].copy()


class State:
    """Stores the newest value of a rate, and the quality of its signal.

    Parameters
    ----------
    rate, beside
        Names of the features with the rate, and with its number of intervals.
    every_s
        Longest time between two values while nothing is wrong, in s.
    trust_at
        Channel of the same stream with the quality of the rate's source; 0 if there is none.
    """

    def __init__(
        self, name: str, rate: str, beside: str, every_s: float, trust_at: int = 0
    ) -> None:
        self._name, self._rate, self._beside, self._trust_at = name, rate, beside, trust_at
        self._holds_s = every_s + at.LUMP_S
        self._stamp = self._value = self._count = self._quality = self._trust = math.nan

    def note(self, events: Sequence[Event]) -> None:
        """Note the values of events."""
        for each in events:
            if each.feature == self._rate:
                self._stamp, self._value = each.stamp, each.values[0]
            elif each.feature == self._beside:
                self._count = each.values[0]
                self._trust = each.values[self._trust_at] if self._trust_at else math.nan
            elif each.feature == "sqi":
                self._quality = each.values[0]

    def at(self, stamp: float) -> Event:
        """Return value, age (s), quality, motion and count at a time.

        The value is NaN when the newest one is outdated. Motion is NaN; `Beside` fills it in.
        """
        age_s = stamp - self._stamp
        if not age_s <= self._holds_s:
            return Event(self._name, stamp, (math.nan, age_s, self._quality, math.nan, 0.0))
        # A rate is as good as what it was computed from, however good the signal is by now.
        quality = float(np.fmin(self._quality, self._trust))
        values = (self._value, age_s, quality, math.nan, self._count)
        return Event(self._name, stamp, values)


def band_pass(low_hz: float, high_hz: float, length_s: float, rate: float) -> Array:
    """Return a linear-phase band-pass, a sinc in a Hamming window, shape (n,) with n odd.

    Its delay is ``(n - 1) / 2`` samples, its gain is 0 for a constant and 1 in the middle of the
    band.
    """
    half = max(1, round(length_s * rate / 2))
    n = np.arange(-half, half + 1)
    window = np.hamming(len(n))

    def low_pass(cut_hz: float) -> Array:
        taps = np.sinc(2 * min(cut_hz, 0.49 * rate) / rate * n) * window
        return taps / taps.sum()

    taps = low_pass(high_hz) - low_pass(low_hz)
    gain = abs((taps * np.exp(-1j * math.pi * (low_hz + high_hz) / rate * n)).sum())
    return taps / gain


class Fir:
    """FIR filter for pieces of equal length; the first sample is assumed to have come before."""

    def __init__(self, taps: Array) -> None:
        self._taps = taps
        self._before: Array | None = None

    def take(self, values: Array) -> Array:
        """Return as many values as were given, delayed by half of the filter's length."""
        if self._before is None:
            self._before = np.full(len(self._taps) - 1, values[0])
        joined = np.concatenate([self._before, values])
        self._before = joined[len(values) :]
        return np.convolve(joined, self._taps, "valid")


class Decimator:
    """Averages neighbouring samples, down to a rate from `wanted_hz` to less than twice that."""

    def __init__(self, rate: float, wanted_hz: float) -> None:
        self._factor = max(1, math.floor(rate / wanted_hz))
        self.rate = rate / self._factor  # Rate of the output, in Hz.
        self._hops = Hops(self._factor)

    def take(self, stamps: Array, values: Array) -> Iterator[tuple[float, float]]:
        """Yield the stamp of the middle, and the mean, of each group."""
        if self._factor == 1:
            yield from zip(stamps.tolist(), values.tolist(), strict=True)
            return  # nothing is dropped: all samples were given as they are
        for times, group in self._hops.take(stamps, values):
            yield (float(times[0]) + float(times[-1])) / 2, float(group.sum()) / self._factor
