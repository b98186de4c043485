"""Computes the quality of windows of a signal, from 0 to 1, with reasons for a low one.

References are in :mod:`.parameters`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway import pulses
from biosensor_gateway.features import parameters as at
from biosensor_gateway.features.repeats import repeats
from biosensor_gateway.features.runs import Array, Event, Hops
from biosensor_gateway.features.skin import least_response
from biosensor_gateway.pulses import between_samples, moment


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
    """Return the difference between the waves of a period, from 0 (equal) to 1 (unrelated).

    Samples are sorted by phase, and neighbours are compared, as Lafler and Kinman did with stars.
    A heart's beats differ in interval and height. The waves of an aliased lamp are all equal but
    for noise, which is smoothed, and whose rest is subtracted.

    Parameters
    ----------
    hertz
        Approximation of the strongest frequency.
    """
    raw, rate = averaged(values, rate, at.PPG_APART_RATE_HZ)
    smoothing = np.hanning(round(at.PPG_APART_SMOOTH_S * rate) + 2)[1:-1]
    smoothing /= smoothing.sum()
    slow = np.convolve(raw, smoothing, "valid")
    variance = float(slow.var())
    if not variance > 0:
        return 1.0
    noise = _white_noise(raw, rate) * float(np.square(smoothing).sum()) / variance
    times = np.arange(len(slow)) / rate
    kept = round((1 - at.PPG_APART_TRIMMED) * len(slow))

    def at_hertz(tried: float) -> float:
        order = np.argsort(times * tried % 1, kind="stable")
        steps = np.square(np.diff(slow[order], append=slow[order[0]]))
        least = float(np.sort(steps)[:kept].sum()) / len(slow) / (2 * variance)
        return least - at.PPG_APART_NOISE * noise

    found: list[float] = []
    # The strongest frequency may be the first overtone.
    for begin in (hertz, hertz / 2):
        best, found_hz = at_hertz(begin), begin
        for step_hz in at.PPG_APART_STEPS_HZ if best < at.PPG_APART_NEAR else ():
            around = [found_hz + place * step_hz for place in range(-4, 5)]
            best, found_hz = min((at_hertz(each), each) for each in around)
        found.append(best)
    return min(found)


def _white_noise(values: Array, rate: float) -> float:
    """Return the variance of white noise in a pulse, estimated above its strong overtones."""
    window = np.hanning(len(values))
    spectrum = np.square(np.abs(np.fft.rfft((values - values.mean()) * window)))
    is_above = np.fft.rfftfreq(len(values), 1 / rate) >= at.PPG_NOISE_HZ
    # The median leaves out single lines; it is that of an exponential distribution.
    return float(np.median(spectrum[is_above])) / math.log(2) / float(np.square(window).sum())


def averaged(values: Array, rate: float, wanted_hz: float) -> tuple[Array, float]:
    """Return means of neighbouring samples, and their rate, from `wanted_hz` to twice that."""
    factor = max(1, int(rate // wanted_hz))
    whole = len(values) // factor * factor
    # nothing is dropped: an estimate of noise needs no part of a mean
    return values[:whole].reshape(-1, factor).mean(axis=1), rate / factor


def unevenness(values: Array, rate: float, block_s: float) -> float:
    """Return the span of the widest block relative to the median block."""
    spans, usual = _spans(values, rate, block_s)
    return float(spans.max()) / usual if usual > 0 else 1.0


def _weakness(values: Array, rate: float) -> float:
    """Return the span of the median block relative to the narrowest; each block has a beat."""
    spans, usual = _spans(values, rate, at.WEAK_BLOCK_S)
    return usual / float(spans.min()) if spans.min() > 0 else math.inf


def _spans(values: Array, rate: float, block_s: float) -> tuple[Array, float]:
    """Return the spans of blocks, and their median."""
    length = min(len(values), max(1, round(block_s * rate)))
    # nothing is dropped: an estimate needs no part of a span
    spans = np.ptp(values[: len(values) // length * length].reshape(-1, length), axis=1)
    return spans, float(np.median(spans))


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


REASONS = ("flat", "clipped", "noisy", "baseline", "out_of_range")
"""Reasons for a low quality, in the order of the channels."""
Judged = tuple[float, tuple[str, ...]]
_KEPT_S = max(at.HRV_WINDOWS_S) + 60.0
"""How long qualities are stored, with a margin because samples may arrive in lumps."""


def _scaled(value: float, limits: tuple[float, float]) -> float:
    """Return 0 up to the lower limit, 1 from the upper limit on, and linear values between."""
    low, high = limits
    return min(1.0, max(0.0, (value - low) / (high - low)))


def _even(values: Array, rate: float, limits: tuple[float, float], block_s: float) -> float:
    return 1 - _scaled(unevenness(values, rate, block_s), limits)


def _power(values: Array, rate: float) -> Callable[[float, float], float]:
    spectrum = np.square(np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values)))))
    frequencies = np.fft.rfftfreq(len(values), 1 / rate)

    def between(low_hz: float, high_hz: float) -> float:
        return float(spectrum[(frequencies >= low_hz) & (frequencies < high_hz)].sum())

    return between


def _share(part: float, whole: float) -> float:
    return part / whole if whole > 0 else 0.0


def _judged(scores: Mapping[str, float], held: Mapping[str, bool]) -> Judged:
    wrong = tuple(name for name, is_so in held.items() if is_so)
    poor = tuple(name for name, score in scores.items() if score < at.GOOD_QUALITY)
    quality = 0.0 if wrong else min(scores.values())
    return quality, wrong + poor


def ecg(values: Array, rate: float) -> Judged:
    """Judge an ECG by beat similarity, Orphanidou 2015, and by kurtosis and power, Li 2008.

    A part with a much larger span than the others, as from an electrode pop, is noise, too, and so
    is what changes its height, whose beats are then not all found.
    """
    power = _power(values, rate)
    usual = power(1, 40)
    noisy = min(
        _scaled(moment(values, 4), at.ECG_KURTOSIS),
        _scaled(_share(power(5, 15), power(5, 40)), at.ECG_QRS_SHARE),
        _scaled(_share(usual, power(1, rate)), at.ECG_HUM_SHARE),
        _scaled(ecg_similarity(values, rate), at.ECG_LIKENESS),
        _even(values, rate, at.ECG_UNEVENNESS, at.ECG_BLOCK_S),
        1 - _scaled(_weakness(values, rate), at.WEAK_TIMES),
    )
    baseline = _scaled(_share(usual, power(0, 40)), at.ECG_BASELINE_SHARE)
    return _judged({"noisy": noisy, "baseline": baseline}, repeats(values, rate))


def _upright(values: Array, rate: float) -> Array:
    """Invert a pulse that is upside down, as in some reflective sensors."""
    spectrum = np.fft.rfft(values - values.mean())
    frequencies = np.fft.rfftfreq(len(values), 1 / rate)
    low, high = pulses.BAND_HZ
    spectrum[(frequencies < low) | (frequencies > high)] = 0
    return -values if moment(np.fft.irfft(spectrum, len(values)), 3) < -pulses.SKEWNESS else values


def _waves(values: Array, rate: float) -> float:
    """Return a score for waves of a heart rather than of a lamp or a swinging arm.

    A pulse has much of its power in overtones; an aliased lamp has little, and a swinging limb not
    much more. The faster a pulse is, the fewer overtones it has. A switched lamp has overtones, but
    its waves are all equal.
    """
    low, high = pulses.BAND_HZ
    spectrum = np.square(np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values)))))
    frequencies = np.fft.rfftfreq(len(values), 1 / rate).astype(np.float64)
    inside = (frequencies >= low) & (frequencies < high)
    spectrum, frequencies = spectrum[inside], frequencies[inside]
    strongest = _top_hz(spectrum, frequencies)
    others = np.abs(frequencies - strongest) > at.PPG_LINE_HZ
    share = _share(float(spectrum[others].sum()), float(spectrum.sum()))
    rounder = min(1.0, at.PPG_ROUND_HZ / strongest) ** 3
    waves = min(
        _scaled(share / rounder, at.PPG_OTHER_WAVES),
        1 - _scaled(_hum(spectrum, frequencies), at.PPG_HUM_SHARE),
        _alone(spectrum, frequencies),
    )
    return min(waves, _scaled(apart(values, rate, strongest), at.PPG_APART)) if waves > 0 else 0.0


def _hum(spectrum: Array, frequencies: Array) -> float:
    """Return the share of power too fast for a heart, if stronger than all below it.

    The hum of mains in a slowly sampled pulse is at any frequency, and looks like pulses. Overtones
    of a steep pulse have less power than the ones before them.
    """
    strongest = _top_hz(spectrum, frequencies)
    is_fast = frequencies >= at.PPG_HUM_HZ
    if strongest < at.PPG_HUM_HZ:
        for times in (1, 2):
            is_fast &= np.abs(frequencies - times * strongest) > at.PPG_LINE_HZ
    hum = _top_hz(np.where(is_fast, spectrum, 0.0), frequencies)
    is_below = (frequencies > hum - at.PPG_HUM_BELOW_HZ) & (frequencies < hum - at.PPG_LINE_HZ)
    below = _top_hz(np.where(is_below, spectrum, 0.0), frequencies)
    at_hum, at_below = (
        float(spectrum[np.abs(frequencies - each) < at.PPG_SECOND_NEAR_HZ].sum())
        for each in (hum, below)
    )
    return _share(at_hum - at_below, float(spectrum.sum()))


def _alone(spectrum: Array, frequencies: Array) -> float:
    """Return a score for the absence of a second source of waves, such as a pulse below steps.

    With a second source, the spectrum without the strongest waves and their overtones has one
    frequency and its overtones again. An irregular rhythm leaves power, but not at one frequency.
    """
    strongest = _top_hz(spectrum, frequencies)
    overtones = np.maximum(1, np.round(frequencies / strongest)) * strongest
    low, high = at.PPG_SECOND_HZ
    is_left = (np.abs(frequencies - overtones) >= at.PPG_LINE_HZ) & (frequencies >= low)
    left: Array = np.where(is_left, spectrum, 0.0)
    second = _top_hz(np.where(frequencies < high, left, 0.0), frequencies)
    is_part = any(
        abs(parts * second - strongest) < at.PPG_SECOND_FRACTION_HZ
        for parts in at.PPG_SECOND_FRACTIONS
    )
    near = np.abs(frequencies - second) < at.PPG_SECOND_NEAR_HZ
    if is_part or left[near].sum() <= at.PPG_SECOND_SHARE * spectrum.sum():
        return 1.0
    for parts in at.PPG_SECOND_FRACTIONS:
        near |= np.abs(frequencies - parts * second) < at.PPG_SECOND_NEAR_HZ
    return 1 - _scaled(float(left[near].sum() / left.sum()), at.PPG_SECOND_ALONE)


def _top_hz(spectrum: Array, frequencies: Array) -> float:
    """Return the strongest frequency, interpolated between those of the spectrum."""
    place = int(spectrum.argmax())
    if not 0 < place < len(spectrum) - 1 or not spectrum[place - 1 : place + 2].min() > 0:
        return float(frequencies[place])
    late = between_samples(*np.log(spectrum[place - 1 : place + 2]).tolist())
    return float(frequencies[place] + late * (frequencies[1] - frequencies[0]))


def ppg(values: Array, rate: float) -> Judged:
    """Judge a pulse by beat similarity, Orphanidou 2015, and skewness, Elgendi 2016.

    Also by the power outside its band, and by a second with a much larger span than the others.
    """
    values = _upright(values, rate)
    power = _power(values, rate)
    inside = power(*pulses.BAND_HZ)
    noisy = _scaled(_share(inside, power(pulses.BAND_HZ[0], rate)), at.PPG_BAND_SHARE)
    shape = _scaled(moment(values, 3), at.PPG_SKEWNESS)
    like = _scaled(ppg_similarity(values, rate), at.PPG_LIKENESS)
    even = _even(values, rate, at.PPG_UNEVENNESS, at.PPG_BLOCK_S)
    steady = 1 - _scaled(_weakness(values, rate), at.WEAK_TIMES)
    waves = _waves(values, rate)
    return _judged({"noisy": min(noisy, shape, like, even, steady, waves)}, repeats(values, rate))


def gsr(values: Array, rate: float) -> Judged:
    """Judge skin conductance, in microsiemens, by the share of its last seconds that is valid.

    Rules 1, 2 and 4 of Kleckner 2018: its range, its slope, and the distance to invalid samples.
    Rule 3 needs another stream; see `Warmth`. Slopes are computed from means of neighbours, because
    the noise of single samples is steeper the faster they are sampled. At a low conductance, as at
    a wrist, a smaller step is a jump. Noise that hides responses is not in these rules, and neither
    are touches, which fall as fast as they rise.

    Parameters
    ----------
    values
        More than the window: of what comes before it, only the falls count.
    """
    slow, slow_hz = averaged(values, rate, at.EDA_RATE_HZ)
    window = round(at.QUALITY_WINDOW_S["GSR"] * slow_hz)
    falls, slow = _falls(slow, slow_hz)[-window:], slow[-window:]
    low, high = at.EDA_RANGE_MICROSIEMENS
    is_out = (slow < low) | (slow > high)
    least, most = at.EDA_SLOPE_MICROSIEMENS_PER_S
    steepest = min(most, max(least, at.EDA_SLOPE_LEVELS_PER_S * float(np.median(slow))))
    jumps = falls | (np.abs(np.diff(slow, prepend=slow[0])) * slow_hz > steepest)
    near = round(at.EDA_INVALID_NEAR_S * slow_hz)
    last = slice(-near, None)
    reasons = {"out_of_range": is_out, "noisy": jumps}
    scores = {name: 1 - float(_spread(each, near)[last].mean()) for name, each in reasons.items()}
    hides = _scaled(least_response(slow, slow_hz), at.EDA_LEAST_MICROSIEMENS)
    scores["noisy"] = min(scores["noisy"], 1 - hides)
    quality = min(1 - float(_spread(is_out | jumps, near)[last].mean()), 1 - hides)
    return quality, _judged(scores, {})[1]


def _falls(levels: Array, rate: float) -> NDArray[np.bool_]:
    """Return which levels belong to a touch or a dip of about a second; no response falls so fast.

    Half of a response is gone after 2 s at the earliest, Boucsein 2012, so that a second takes at
    most 0.3 of what it rose by. Levels that swing all the time are not judged.
    """
    is_fallen = np.zeros(len(levels), np.bool_)
    second, before = round(at.EDA_FALL_S * rate), round(at.EDA_BEFORE_FALL_S * rate)
    width = 2 * round(at.SCR_SMOOTHING_S * rate / 2) + 1
    smooth = np.convolve(np.pad(levels, width // 2, "edge"), np.full(width, 1 / width), "valid")
    falls = smooth[:-second] - smooth[second:]
    if len(falls) <= second:
        return is_fallen
    trend = float(np.median(falls))
    usual = float(np.median(np.abs(falls - trend)))
    least = max(least_response(levels, rate), at.EDA_FALL_TIMES * usual)
    # A response goes on falling; a level that falls all the time is not part of it.
    ends = np.minimum(falls[:-second] - trend, falls[:-second] - falls[second:])
    for place in np.flatnonzero(ends > least):
        since = max(0, place - before)
        if place - since < before / 2:
            continue  # nothing is dropped: what it rose by is not known yet
        known = smooth[since : place + 1]
        rise, span = smooth[place] - known.min(), np.ptp(known)
        if ends[place] > at.EDA_FALL_SHARE * rise + at.EDA_FALL_BELOW_SHARE * span:
            is_fallen[place : place + second + 1] = True
    return is_fallen


def _spread(flags: NDArray[np.bool_], near: int) -> NDArray[np.bool_]:
    """Return flags that also cover the *near* samples on both sides of each flag."""
    counts = np.cumsum(np.pad(flags, (near + 1, near)))
    return counts[2 * near + 1 :] > counts[: -2 * near - 1]


def respiration(values: Array, rate: float) -> Judged:
    """Judge breathing by the share of power in its band, and by the evenness of its depth."""
    power = _power(values, rate)
    share = _share(power(*at.BREATH_BAND_HZ), power(0, rate))
    inside = _scaled(share, at.BREATH_BAND_SHARE)
    even = _even(values, rate, at.BREATH_UNEVENNESS, at.BREATH_BLOCK_S)
    return _judged({"noisy": min(inside, even)}, repeats(values, rate))


JUDGES: Mapping[str, Callable[[Array, float], Judged]] = {
    "ECG": ecg,
    "PPG": ppg,
    "GSR": gsr,
    "Respiration": respiration,
}
"""Function for each LSL content type."""


class Quality:
    """Gives `sqi` of successive windows of a run, stamped with their ends.

    The motion channel is NaN; `Beside` fills it in.

    Parameters
    ----------
    content_type
        One of `JUDGES`.
    rate
        Nominal rate in Hz.
    """

    def __init__(self, content_type: str, rate: float) -> None:
        self._judge, self._rate = JUDGES[content_type], rate
        piece = max(1, round(at.QUALITY_EVERY_S * rate))
        self._hops = Hops(piece)
        self._window_s = at.QUALITY_WINDOW_S[content_type]
        self._least_pieces = max(1, round(self._window_s * rate / piece))
        before_s = at.EDA_BEFORE_FALL_S if content_type == "GSR" else 0.0
        # nothing is dropped: what a window slides over
        self._pieces: deque[Array] = deque(
            maxlen=self._least_pieces + round(before_s * rate / piece)
        )
        self._qualities: deque[tuple[float, float]] = deque()

    def take(self, stamps: Array, values: Array) -> list[Event]:
        """Take samples of one run in; both of shape (n,)."""
        events: list[Event] = []
        for times, piece in self._hops.take(stamps, values):
            self._pieces.append(piece)
            if len(self._pieces) < self._least_pieces:
                continue  # nothing is dropped: the first window is not full yet
            quality, reasons = self._judge(np.concatenate(self._pieces), self._rate)
            flags = tuple(float(each in reasons) for each in REASONS)
            stamp = float(times[-1])
            events.append(Event("sqi", stamp, (quality, *flags, math.nan)))
            self._qualities.append((stamp, quality))
            while self._qualities[0][0] < stamp - _KEPT_S:
                self._qualities.popleft()
        return events

    def worst(self, begin_s: float, end_s: float) -> float:
        """See `heart.Trust`."""
        earliest = begin_s + self._window_s
        inside = (quality for stamp, quality in self._qualities if earliest <= stamp <= end_s)
        return min(inside, default=math.nan)
