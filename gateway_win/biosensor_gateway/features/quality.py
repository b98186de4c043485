"""Judges how far windows of a signal can be trusted, from 0 to 1, and says why not.

References are in :mod:`.thresholds`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.features import thresholds as at
from biosensor_gateway.features.likeness import (
    averaged,
    ecg_likeness,
    ppg_likeness,
    unevenness,
)
from biosensor_gateway.features.runs import Array, Event, Hops

REASONS = ("flat", "clipped", "noisy", "baseline", "out_of_range")
"""What a window may suffer from, in the order of the channels."""

Judged = tuple[float, tuple[str, ...]]
_GOOD = 0.5


def _scaled(value: float, limits: tuple[float, float]) -> float:
    """Return 0 up to the lower limit, 1 from the upper one on."""
    low, high = limits
    return min(1.0, max(0.0, (value - low) / (high - low)))


def _even(values: Array, rate: float, limits: tuple[float, float], block_s: float = 1) -> float:
    return 1 - _scaled(unevenness(values, rate, block_s), limits)


def _power(values: Array, rate: float) -> Callable[[float, float], float]:
    spectrum = np.square(np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values)))))
    frequencies = np.fft.rfftfreq(len(values), 1 / rate)

    def between(low_hz: float, high_hz: float) -> float:
        return float(spectrum[(frequencies >= low_hz) & (frequencies < high_hz)].sum())

    return between


def _share(part: float, whole: float) -> float:
    return part / whole if whole > 0 else 0.0


def _held(values: Array) -> dict[str, bool]:
    """Whether a signal stands still, or stays at one of its ends."""
    still: NDArray[np.bool_] = values[1:] == values[:-1]
    at_end = (values[1:] == values.max()) | (values[1:] == values.min())
    return {
        "flat": int(np.count_nonzero(still)) >= at.FLAT_SHARE * len(still),
        "clipped": int(np.count_nonzero(still & at_end)) >= at.CLIPPED_SHARE * len(still),
    }


def _moment(values: Array, order: Literal[3, 4]) -> float:
    """Return skewness or kurtosis."""
    centred = values - values.mean()
    spread = float(np.sqrt(np.square(centred).mean()))
    if spread <= 0:
        return 0.0
    scaled: Array = centred / spread
    squares = np.square(scaled)
    # np.power takes twenty times as long.
    return float((squares * (scaled if order == 3 else squares)).mean())


def _judged(scores: Mapping[str, float], held: Mapping[str, bool]) -> Judged:
    wrong = tuple(name for name, is_so in held.items() if is_so)
    poor = tuple(name for name, score in scores.items() if score < _GOOD)
    quality = 0.0 if wrong else min(scores.values())
    return quality, wrong + poor


def ecg(values: Array, rate: float) -> Judged:
    """Judge an ECG by how like its beats are, Orphanidou 2015, by kurtosis and power, Li 2008.

    One second that is much wilder than the others, as of an electrode pop, is noise, too.
    """
    power = _power(values, rate)
    usual = power(1, 40)
    noisy = min(
        _scaled(_moment(values, 4), at.ECG_KURTOSIS),
        _scaled(_share(power(5, 15), power(5, 40)), at.ECG_QRS_SHARE),
        _scaled(_share(usual, power(1, rate)), at.ECG_HUM_SHARE),
        _scaled(ecg_likeness(values, rate), at.ECG_LIKENESS),
        _even(values, rate, at.ECG_UNEVENNESS),
    )
    baseline = _scaled(_share(usual, power(0, 40)), at.ECG_BASELINE_SHARE)
    return _judged({"noisy": noisy, "baseline": baseline}, _held(values))


def _upright(values: Array, rate: float) -> Array:
    """Turn a pulse over that is upside down, as where reflected light is counted."""
    spectrum = np.fft.rfft(values - values.mean())
    frequencies = np.fft.rfftfreq(len(values), 1 / rate)
    low, high = at.PULSE_BAND_HZ
    spectrum[(frequencies < low) | (frequencies > high)] = 0
    return (
        -values if _moment(np.fft.irfft(spectrum, len(values)), 3) < -at.PULSE_SKEWNESS else values
    )


def ppg(values: Array, rate: float) -> Judged:
    """Judge a pulse by how like its beats are, Orphanidou 2015, and skewness, Elgendi 2016.

    Besides, by power outside of its band, and a second that is much wilder than the others.
    """
    values = _upright(values, rate)
    power = _power(values, rate)
    inside = power(*at.PULSE_BAND_HZ)
    noisy = _scaled(_share(inside, power(at.PULSE_BAND_HZ[0], rate)), at.PPG_BAND_SHARE)
    shape = _scaled(_moment(values, 3), at.PPG_SKEWNESS)
    like = _scaled(ppg_likeness(values, rate), at.PPG_LIKENESS)
    even = _even(values, rate, at.PPG_UNEVENNESS)
    return _judged({"noisy": min(noisy, shape, like, even)}, _held(values))


def gsr(values: Array, rate: float) -> Judged:
    """Return the share of samples of skin conductance, in microsiemens, that can be: Kleckner.

    Slopes are those of means of neighbours, since noise of single samples is steeper the faster
    they are taken.
    """
    slow, slow_hz = averaged(values, rate, at.EDA_RATE_HZ)
    low, high = at.EDA_RANGE_MICROSIEMENS
    is_out = (slow < low) | (slow > high)
    jumps = np.abs(np.diff(slow, prepend=slow[0])) * slow_hz > at.EDA_SLOPE_MICROSIEMENS_PER_S
    good = {"out_of_range": 1 - float(is_out.mean()), "noisy": 1 - float(jumps.mean())}
    quality, reasons = _judged(good, {})
    return min(quality, 1 - float((is_out | jumps).mean())), reasons


def respiration(values: Array, rate: float) -> Judged:
    """Judge breathing by the share of power in its band, and by how alike breaths are in depth."""
    power = _power(values, rate)
    share = _share(power(*at.BREATH_BAND_HZ), power(0, rate))
    inside = _scaled(share, at.BREATH_BAND_SHARE)
    even = _even(values, rate, at.BREATH_UNEVENNESS, at.BREATH_BLOCK_S)
    return _judged({"noisy": min(inside, even)}, _held(values))


JUDGES: Mapping[str, Callable[[Array, float], Judged]] = {
    "ECG": ecg,
    "PPG": ppg,
    "GSR": gsr,
    "Respiration": respiration,
}
"""By LSL content type."""


class Quality:
    """Gives `sqi` for each window of a run, stamped with the window's end.

    Parameters
    ----------
    content_type
        One of `JUDGES`.
    rate
        Nominal, in Hz.
    """

    def __init__(self, content_type: str, rate: float) -> None:
        self._judge, self._rate = JUDGES[content_type], rate
        self._hops = Hops(max(8, round(at.QUALITY_WINDOW_S[content_type] * rate)))

    def take(self, stamps: Array, values: Array) -> list[Event]:
        """Take samples of one run in; both of shape (n,)."""
        events: list[Event] = []
        for times, window in self._hops.take(stamps, values):
            quality, reasons = self._judge(window, self._rate)
            told = tuple(float(each in reasons) for each in REASONS)
            events.append(Event("sqi", float(times[-1]), (quality, *told)))
        return events
