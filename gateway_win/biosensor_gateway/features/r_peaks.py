"""Finds R peaks in an ECG.

The energy in the band of QRS complexes [2]_ is compared with adaptive thresholds, by the rules of
Hamilton's detector [1]_: references are in :mod:`.parameters`. The apex is then looked for in the
unfiltered signal.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from statistics import median
from typing import NamedTuple

import numpy as np

from biosensor_gateway.features import parameters as at
from biosensor_gateway.features.runs import Array, Fir, Hops, band_pass
from biosensor_gateway.pulses import Beat, between_samples


class _Peak(NamedTuple):
    place: int
    energy: float
    apex: int
    beat: Beat
    slope: float


class RPeaks:
    """Finds the apex of each QRS complex, with a fixed delay.

    Parameters
    ----------
    rate
        Nominal rate in Hz.
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._hop = max(1, round(at.HOP_S * rate))
        self._hops = Hops(self._hop)
        taps = band_pass(*at.ECG_BAND_HZ, at.ECG_FILTER_S, rate)
        width = 2 * round(at.QRS_S * rate / 2) + 1
        self._filter = Fir(taps)
        self._mean = Fir(np.full(width, 1 / width))
        self._late = (len(taps) - 1) // 2 + (width - 1) // 2
        self._near = max(1, round(at.QRS_NEIGHBOUR_S * rate))
        self._around = max(1, round(at.APEX_S * rate))
        self._keep = 2 * self._near + self._late + self._around + self._hop + 2
        self._signal = self._energy = self._stamps = np.empty(0)
        self._count = 0
        self._rule = _Hamilton(rate)
        self._polarity = 0.0

    def take(self, stamps: Array, values: Array) -> list[Beat]:
        """Return the beats that are decided by now.

        Parameters
        ----------
        stamps, values : ndarray of float64, shape (n,)
        """
        return [
            beat
            for times, piece in self._hops.take(stamps, values)
            for beat in self._piece(times, piece)
        ]

    def _piece(self, stamps: Array, values: Array) -> list[Beat]:
        energy = self._mean.take(np.square(self._filter.take(values)))
        self._stamps = np.concatenate([self._stamps, stamps])[-self._keep :]
        self._signal = np.concatenate([self._signal, values])[-self._keep :]
        self._energy = np.concatenate([self._energy, energy])[-self._keep :]
        self._count += self._hop
        beats: list[Beat] = []
        for place in self._candidates():
            beats += self._rule.take(self._peak(place))
        return beats + self._rule.pass_time(self._count - self._near)

    def _candidates(self) -> list[int]:
        """Return the places of local maxima of the energy, in the stored signal."""
        size = len(self._energy)
        begin, end = size - self._hop - self._near, size - self._near
        if begin < self._near + self._late + self._around + 1:
            return []  # nothing is dropped: it waits for more samples
        here = self._energy[begin - 1 : end + 1]
        middle = here[1:-1]
        tops = np.flatnonzero((middle > here[:-2]) & (middle >= here[2:])) + begin
        return [
            top
            for top in tops.tolist()
            if self._energy[top] >= self._energy[top - self._near : top + self._near + 1].max()
        ]

    def _peak(self, top: int) -> _Peak:
        middle = top - self._late
        begin = middle - self._around
        around = self._signal[begin : middle + self._around + 1]
        level = float(np.median(around))
        up, down = float(around.max()) - level, level - float(around.min())
        # The polarity changes slowly; otherwise the apex would jump between R and S waves.
        self._polarity += 0.2 * ((up - down) / (up + down or 1.0) - self._polarity)
        is_up = self._polarity > -0.1
        apex = begin + int(around.argmax() if is_up else around.argmin())
        slope = float(np.abs(np.diff(around)).max(initial=0.0))
        start = self._count - len(self._signal)
        stamp = float(self._stamps[apex])
        late = between_samples(*self._signal[apex - 1 : apex + 2].tolist())
        beat = Beat(stamp, stamp + late / self._rate)
        return _Peak(start + top, float(self._energy[top]), start + apex, beat, slope)


class _Hamilton:
    """Decides which peaks of the energy are beats."""

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._learns = [round(each * rate) for each in at.LEARNING_S]
        self._begin_again(0)
        self._last: _Peak | None = None
        # nothing is dropped: a memory of beats
        self._places: deque[int] = deque(maxlen=at.GROWN_LAST + 1)
        # nothing is dropped: a memory of beats
        self._intervals: deque[float] = deque(maxlen=at.PEAKS_KEPT)

    def _begin_again(self, place: int) -> None:
        self._learnt: list[_Peak] | None = []
        self._learns_from = place
        # nothing is dropped: a memory of beats
        self._beats: deque[float] = deque(maxlen=at.PEAKS_KEPT)
        # nothing is dropped: a memory of noise
        self._noise: deque[float] = deque([0.0], maxlen=at.PEAKS_KEPT)
        self._huge: list[_Peak] = []
        self._passed_over: list[_Peak] = []

    def take(self, peak: _Peak) -> list[Beat]:
        """Take a peak; return the beats that it decides."""
        if self._learnt is not None:
            self._learnt.append(peak)
            return []  # nothing is dropped: it is judged when learning ends
        return self._judge(peak)

    def pass_time(self, place: int) -> list[Beat]:
        """Note that all peaks before this place were passed; return the beats decided by this."""
        if self._learnt is not None:
            return self._learn(place)
        beats = self._search_back(place)
        since = self._learns_from if self._last is None else self._last.place
        if place - max(since, self._learns_from) > at.LOST_S * self._rate:
            self._begin_again(place)
        return beats

    def _learn(self, place: int) -> list[Beat]:
        least, most = self._learns
        if place - self._learns_from < least or not self._learnt:
            return []  # nothing is dropped: it goes on learning
        second = round(self._rate)
        largest: dict[int, float] = {}
        for peak in self._learnt:
            number = (peak.place - self._learns_from) // second
            largest[number] = max(largest.get(number, 0.0), peak.energy)
        heights = sorted(largest.values(), reverse=True)
        if heights[-1] < at.LEARNING_ALIKE * heights[0]:
            # Some of these seconds had no beat, as with a slow heart, or one had an artefact.
            if place - self._learns_from < most:
                return []  # nothing is dropped: it goes on learning
            usual = heights[min(at.LEARNING_ARTEFACTS, len(heights) - 1)]
            heights = [each for each in heights if each >= at.LEARNING_ALIKE * usual]
        self._beats.extend(heights)
        peaks, self._learnt = self._learnt, None
        self._learns_from = place
        return [beat for peak in peaks for beat in self._judge(peak)]

    @property
    def _threshold(self) -> float:
        noise, beat = median(self._noise), median(self._beats)
        return noise + at.DETECTION_THRESHOLD * (beat - noise)

    def _judge(self, peak: _Peak) -> list[Beat]:
        last = self._last
        since_s = np.inf if last is None else (peak.apex - last.apex) / self._rate
        if since_s < at.REFRACTORY_S:
            return []  # nothing is dropped: no beat follows another one so fast
        is_t_wave = (
            last is not None and since_s < at.T_WAVE_S and peak.slope < at.T_WAVE_SHARE * last.slope
        )
        if peak.energy > self._threshold and not is_t_wave:
            return self._accept(peak)
        self._noise.append(peak.energy)
        if since_s >= at.T_WAVE_S:
            self._passed_over.append(peak)
        return []  # nothing is dropped: the peak is not a beat; `_search_back` may use it

    def _search_back(self, place: int) -> list[Beat]:
        if self._last is None or len(self._intervals) < 2 or not self._passed_over:
            return []  # nothing is dropped: there is nothing to look for
        usual = median(self._intervals)
        if place - self._last.place < at.SEARCH_BACK_INTERVALS * usual:
            return []  # nothing is dropped: a beat may still come
        best = max(self._passed_over, key=lambda peak: peak.energy)
        if best.energy < at.SEARCH_BACK_SHARE * self._threshold:
            return []  # nothing is dropped: none of them is a beat
        return self._accept(best)

    def _accept(self, peak: _Peak) -> list[Beat]:
        if self._last is not None:
            self._intervals.append(peak.place - self._last.place)
        self._last = peak
        self._beats.append(peak.energy)
        self._places.append(peak.place)
        newest = list(self._beats)[-at.GROWN_LAST :]
        grown = [each for each in newest if each > at.GROWN_TIMES * median(self._beats)]
        if len(grown) > 1:
            # The signal is larger from now on; compared with its beats before, T waves are beats.
            since = self._places[0]
            return self._begin_with(peak, grown, (peak.place - since) / self._rate)
        if self._is_among_noise(peak):
            huge = [each.energy for each in self._huge]
            return self._begin_with(peak, huge, at.HR_WINDOW_S)
        self._passed_over = [each for each in self._passed_over if each.place > peak.place]
        return [peak.beat]

    def _begin_with(self, peak: _Peak, energies: Sequence[float], doubtful_s: float) -> list[Beat]:
        """Return the beat that shows that the signal has grown; compare with larger ones now."""
        # nothing is dropped: a memory of beats
        self._beats.clear()
        self._beats.extend(energies)
        # nothing is dropped: a memory of intervals, which may be those of noise
        self._intervals.clear()
        self._passed_over, self._huge = [], []
        return [peak.beat._replace(doubtful_s=doubtful_s)]

    def _is_among_noise(self, peak: _Peak) -> bool:
        """Whether this beat and the ones before it that are like it are the only true ones.

        After a slow heart's signal has grown a hundredfold, there is more noise than beats.
        """
        if peak.energy <= at.HUGE_TIMES * median(self._beats):
            return False
        most = at.HUGE_APART_S * self._rate
        if self._huge and peak.place - self._huge[-1].place > most:
            self._huge = []
        self._huge = [*self._huge, peak][-at.HUGE_IN_A_ROW :]
        return len(self._huge) == at.HUGE_IN_A_ROW
