"""Measures the similarity of the beats in a window: Orphanidou 2015, and beats that are too equal.

References are in :mod:`.thresholds`. All windows have the same length, so that results are equal to
the last bit however a stream is cut.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.features import thresholds as at
from biosensor_gateway.features.runs import Array
from biosensor_gateway.pulses import thresholds as pulses


def ecg_similarity(values: Array, rate: float) -> float:
    """Return the mean correlation of QRS complexes and their surroundings with their template.

    It is 0 if fewer than three are found.
    """
    slow, rate = averaged(values, rate, at.TEMPLATE_RATE_HZ)
    width = 2 * round(at.QRS_S * rate / 2) + 1
    energy = np.convolve(
        np.square(_band(slow, rate, at.ECG_BAND_HZ)), np.full(width, 1 / width), "same"
    )
    return _similarity(slow, _tops(energy, rate), rate, at.ECG_TEMPLATE_S)


def ppg_similarity(values: Array, rate: float) -> float:
    """Return the mean correlation of pulses with their template; 0 with fewer than three."""
    slow, rate = averaged(values, rate, at.TEMPLATE_RATE_HZ)
    tops = _tops(_band(slow, rate, pulses.BAND_HZ), rate)
    return _similarity(slow, tops, rate, at.PPG_TEMPLATE_S)


def apart(values: Array, rate: float, hertz: float) -> float:
    """Return how much the waves of a period differ, from 0 for equal to 1 for unrelated ones.

    Samples are sorted by phase, and neighbours are compared, as Lafler and Kinman did with stars.
    A heart's beats differ in interval and height. The waves of an aliased lamp are all equal.

    Parameters
    ----------
    hertz
        Approximation of the strongest frequency.
    """
    slow, rate = averaged(values, rate, at.PPG_APART_RATE_HZ)
    times = np.arange(len(slow)) / rate
    whole = 2 * float(slow.var())
    if not whole > 0:
        return 1.0
    kept = round((1 - at.PPG_APART_TRIMMED) * len(slow))

    def at_hertz(tried: float) -> float:
        order = np.argsort(times * tried % 1, kind="stable")
        steps = np.square(np.diff(slow[order], append=slow[order[0]]))
        return float(np.sort(steps)[:kept].sum()) / len(slow) / whole

    found: list[float] = []
    # The strongest frequency may be the first overtone.
    for begin in (hertz, hertz / 2):
        found.append(at_hertz(begin))
        if found[-1] < at.PPG_APART_NEAR:
            found += [at_hertz(begin + place * at.PPG_APART_STEP_HZ) for place in range(-4, 5)]
    return min(found)


def averaged(values: Array, rate: float, wanted_hz: float) -> tuple[Array, float]:
    """Return means of neighbouring samples, and their rate, from `wanted_hz` to twice that."""
    factor = max(1, int(rate // wanted_hz))
    whole = len(values) // factor * factor
    return values[:whole].reshape(-1, factor).mean(axis=1), rate / factor


def unevenness(values: Array, rate: float, block_s: float) -> float:
    """Return the span of the widest block relative to the median block."""
    length = min(len(values), max(1, round(block_s * rate)))
    blocks = values[: len(values) // length * length].reshape(-1, length)
    spans = np.ptp(blocks, axis=1)
    usual = float(np.median(spans))
    return float(spans.max()) / usual if usual > 0 else 1.0


def _band(values: Array, rate: float, band_hz: tuple[float, float]) -> Array:
    spectrum = np.fft.rfft(values - values.mean())
    frequencies = np.fft.rfftfreq(len(values), 1 / rate)
    spectrum[(frequencies < band_hz[0]) | (frequencies > band_hz[1])] = 0
    return np.fft.irfft(spectrum, len(values))


def _tops(values: Array, rate: float) -> NDArray[np.intp]:
    """Return the places of local maxima that have at least a share of the usual height."""
    near = max(1, round(at.TEMPLATE_APART_S * rate))
    padded = np.pad(values, near, constant_values=-np.inf)
    largest = np.lib.stride_tricks.sliding_window_view(padded, 2 * near + 1).max(axis=1)
    second = min(len(values), round(rate))
    usual = np.median(values[: len(values) // second * second].reshape(-1, second).max(axis=1))
    return np.flatnonzero((values == largest) & (values > at.TEMPLATE_SHARE * usual))


def _similarity(
    values: Array, tops: NDArray[np.intp], rate: float, around_s: tuple[float, float]
) -> float:
    before, after = (round(each * rate) for each in around_s)
    inside = tops[(tops >= before) & (tops + after < len(values))]
    if len(inside) < at.TEMPLATE_LEAST:
        return 0.0
    beats = values[inside[:, np.newaxis] + np.arange(-before, after + 1)]
    beats = beats - beats.mean(axis=1, keepdims=True)
    sizes = np.sqrt(np.square(beats).sum(axis=1))
    if not sizes.min() > 0:
        return 0.0
    shapes = beats / sizes[:, np.newaxis]
    # The median, because one large artefact would dominate a mean.
    template = np.median(shapes, axis=0)
    size = float(np.sqrt(np.square(template).sum()))
    return float((shapes * template).sum(axis=1).mean()) / size if size > 0 else 0.0
