"""The wearer of virtual devices, whose signals are pure functions of time.

Nothing here has a state: any sample can be computed without the previous ones, so a device and a
test agree on the truth given the seed. The phase of beats is a closed function of time (a heart
rate modulated by respiration). Times are seconds since the start of the wearer's world; all
functions take and return arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import pi

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SINUS_ARRHYTHMIA = 0.05
"""Relative modulation of the heart rate by respiration."""
# Height [uV], centre and width [s] at one beat per second: P, Q, R, S, T.
_ECG_WAVES = (
    (120.0, -0.17, 0.025),
    (-100.0, -0.035, 0.010),
    (1100.0, 0.0, 0.011),
    (-220.0, 0.035, 0.011),
    (280.0, 0.26, 0.045),
)
TURN_S = 10.0
"""Duration of a change of the mean heart rate."""
PULSE_TRANSIT_S = 0.22
"""Time from the R peak to the steepest rise of the pulse wave at finger or wrist."""
_NOISE_TONES = 16


@dataclass(frozen=True)
class Wearer:
    """A person with constant respiration rate, and constant or given mean heart rate."""

    seed: int = 0  # Seed of noise and skin responses; equal seeds give equal people.
    # heart_rate_bpm, respiration_rate_bpm: mean rates [1/min].
    heart_rate_bpm: float = 72.0
    respiration_rate_bpm: float = 15.0
    # Times [s] from which the mean heart rate changes to a new value [1/min], within `TURN_S`.
    turns: tuple[tuple[float, float], ...] = ()
    # Periods [s] in which electrodes, lights and belts give the value of their beginning.
    flat: tuple[tuple[float, float], ...] = ()

    def heart_rate(self, t: Floats) -> Floats:
        """Return the momentary heart rate [1/min]."""
        swing = SINUS_ARRHYTHMIA * np.sin(self._breath_omega * t)
        return self._course.rate(t) + self.heart_rate_bpm * swing

    def beat_count(self, t: Floats) -> Floats:
        """Return the fractional number of beats until ``t``, the integral of the heart rate."""
        return self._course.count(t) + self._swing(t)

    def beat_time(self, beats: Floats) -> Floats:
        """Return the times of R peaks [s]: `beat_count` inverted by fixed-point iteration."""
        t = self._course.time(beats)
        for _ in range(12):  # each step shrinks the error by the arrhythmia's swing
            t = self._course.time(beats - self._swing(t))
        return t

    def beats_between(self, begin_s: float, end_s: float) -> Floats:
        """Return the R peaks in ``begin_s <= t < end_s`` [s], oldest first."""
        first, last = self.beat_count(np.array([begin_s, end_s], np.float64))
        times = self.beat_time(np.arange(np.floor(first), np.ceil(last) + 1, dtype=np.float64))
        return times[(times >= begin_s) & (times < end_s)]

    def rr_before(self, beat_times: Floats) -> Floats:
        """Return the interval that ends with each of the given R peaks [s]."""
        beats = np.rint(self.beat_count(beat_times))
        return self.beat_time(beats) - self.beat_time(beats - 1)

    def ecg_uv(self, t: Floats) -> Floats:
        """Return an electrocardiogram with P, Q, R, S and T waves [uV]."""
        t = self._changing(t)
        phase = self.beat_count(t)
        interval_s = 60 / self.heart_rate(t)
        from_peak_s = (phase - np.rint(phase)) * interval_s
        stretch = np.sqrt(interval_s)  # QT follows the square root of R-R (Bazett)
        ecg = np.zeros(t.shape)
        for height, centre_s, width_s in _ECG_WAVES:
            ecg += height * np.exp(-0.5 * ((from_peak_s - centre_s * stretch) / width_s) ** 2)
        return ecg + self.noise(t, 8.0, "ecg")

    def pulse(self, t: Floats) -> Floats:
        """Return the blood volume pulse at a limb, around 0, from about -0.5 to 1."""
        t = self._changing(t)
        phase = self.beat_count(t - PULSE_TRANSIT_S) % 1.0
        systole = np.exp(-0.5 * ((phase - 0.18) / 0.08) ** 2)
        dicrotic = 0.35 * np.exp(-0.5 * ((phase - 0.48) / 0.09) ** 2)
        return systole + dicrotic - 0.28 + self.noise(t, 0.01, "pulse")

    def skin_conductance_us(self, t: Floats) -> Floats:
        """Return skin conductance: a slow level and a response every 12 to 20 s [uS]."""
        t = self._changing(t)
        level = 5.0 + 0.6 * np.sin(2 * pi * t / 97.0)
        onsets = self._response_onsets[np.newaxis, :]
        age = np.maximum((t[:, np.newaxis] % _RESPONSE_CYCLE_S) - onsets, 0.0)
        # The bi-exponential rise and recovery of a skin conductance response.
        responses = 1.9 * (np.exp(-age / 4.0) - np.exp(-age / 0.8))
        return level + responses.sum(axis=1) + self.noise(t, 0.004, "eda")

    def skin_temperature_c(self, t: Floats) -> Floats:
        """Return the skin temperature at the wrist [degrees Celsius]."""
        return 32.5 + 0.4 * np.sin(2 * pi * t / 211.0) + self.noise(t, 0.01, "temperature")

    def chest_force_n(self, t: Floats) -> Floats:
        """Return the force of a belt around the chest [N]."""
        t = self._changing(t)
        return 12.0 + 3.0 * np.sin(self._breath_omega * t) + self.noise(t, 0.02, "belt")

    def acceleration_g(self, t: Floats) -> Floats:
        """Return the acceleration of the trunk at rest with breathing, x y z [g], shape (n, 3)."""
        sway = 0.01 * np.sin(self._breath_omega * t)
        axes = (
            -0.97 + self.noise(t, 0.004, "x"),
            0.05 + sway + self.noise(t, 0.004, "y"),
            0.24 - sway + self.noise(t, 0.004, "z"),
        )
        return np.stack(axes, axis=1)

    def eeg_uv(self, t: Floats, electrode: str) -> Floats:
        """Return an EEG: an alpha rhythm of varying amplitude, and broadband noise [uV]."""
        t = self._changing(t)
        phase = _phase(self.seed, electrode)
        alpha = 12.0 * (1 + 0.5 * np.sin(2 * pi * t / 7.0 + phase))
        rhythm = alpha * np.sin(2 * pi * 10.0 * t + phase)
        return rhythm + self.noise(t, 6.0, electrode)

    def noise(self, t: Floats, rms: float, name: str) -> Floats:
        """Return noise of a given RMS that is the same in every call.

        It is a sum of tones between 0.5 and 45 Hz with frequencies and phases from the seed and
        ``name``.
        """
        frequencies, phases = _tones(self.seed, name)
        tones = np.sin(2 * pi * t[:, np.newaxis] * frequencies + phases)
        return rms * np.sqrt(2 / _NOISE_TONES) * tones.sum(axis=1)

    def _changing(self, t: Floats) -> Floats:
        """Return the times of the measured values; they stand still while the signal is flat."""
        for begin_s, end_s in self.flat:
            t = np.where((t >= begin_s) & (t < end_s), begin_s, t)
        return t

    def _swing(self, t: Floats) -> Floats:
        """Return the number of beats added by respiration until ``t``."""
        omega = self._breath_omega
        return self.heart_rate_bpm / 60 * SINUS_ARRHYTHMIA / omega * (1 - np.cos(omega * t))

    @cached_property
    def _course(self) -> _Course:
        return _Course(self.heart_rate_bpm, self.turns)

    @property
    def _breath_omega(self) -> float:
        return 2 * pi * self.respiration_rate_bpm / 60

    @cached_property
    def _response_onsets(self) -> Floats:
        steps = _rng(self.seed, "responses").uniform(12.0, 20.0, 64)
        onsets = np.cumsum(steps)
        return onsets[onsets < _RESPONSE_CYCLE_S - 30.0]


class _Course:
    """A piecewise linear mean heart rate, with its number of beats."""

    def __init__(self, bpm: float, turns: tuple[tuple[float, float], ...]) -> None:
        times, rates = [0.0], [bpm]
        for begin_s, target_bpm in sorted(turns):
            # A change that starts during the previous one ends it.
            here = float(np.interp(begin_s, times, rates))
            while times[-1] > begin_s:
                del times[-1], rates[-1]
            times += [begin_s, begin_s + TURN_S]
            rates += [here, target_bpm]
        self._times, self._rates = np.array(times), np.array(rates)
        spans = np.diff(self._times)
        means = (self._rates[1:] + self._rates[:-1]) / 2
        self._counts = np.concatenate(([0.0], np.cumsum(spans * means / 60)))
        steepness = np.diff(self._rates) / np.where(spans > 0, spans, 1.0)
        self._slopes = np.concatenate((steepness, [0.0]))

    def rate(self, t: Floats) -> Floats:
        """Return the mean rate [1/min]."""
        return np.interp(t, self._times, self._rates)

    def count(self, t: Floats) -> Floats:
        """Return the number of beats since 0 s."""
        at = self._piece(self._times, t)
        since = t - self._times[at]
        # Before 0 s, the rate is constant.
        slopes = np.where(since < 0, 0.0, self._slopes[at])
        return self._counts[at] + since * (self._rates[at] + slopes * since / 2) / 60

    def time(self, counts: Floats) -> Floats:
        """Return the times at which these numbers of beats are reached [s]."""
        at = self._piece(self._counts, counts)
        beats = 60 * (counts - self._counts[at])
        slopes, rates = np.where(beats < 0, 0.0, self._slopes[at]), self._rates[at]
        return self._times[at] + 2 * beats / (rates + np.sqrt(rates**2 + 2 * slopes * beats))

    def _piece(self, corners: Floats, values: Floats) -> NDArray[np.intp]:
        return np.maximum(np.searchsorted(corners, values, side="right") - 1, 0)


def _rng(seed: int, name: str) -> np.random.Generator:
    return np.random.default_rng((seed, *name.encode("ascii")))


# Called with each packet of each device, always with the same result.
@lru_cache(maxsize=1024)
def _tones(seed: int, name: str) -> tuple[Floats, Floats]:
    """Return the frequencies [Hz] and phases [rad] of a noise."""
    rng = _rng(seed, name)
    return rng.uniform(0.5, 45.0, _NOISE_TONES), rng.uniform(0, 2 * pi, _NOISE_TONES)


@lru_cache(maxsize=1024)
def _phase(seed: int, name: str) -> float:
    (phase,) = _rng(seed, name).uniform(0, 2 * pi, 1)
    return float(phase)


def someone(number: int) -> Wearer:
    """Return one of several people with different heart and respiration rates."""
    return Wearer(number, heart_rate_bpm=64.0 + 7.0 * number, respiration_rate_bpm=13.0 + number)


# Period after which skin conductance responses repeat.
_RESPONSE_CYCLE_S = 600.0
