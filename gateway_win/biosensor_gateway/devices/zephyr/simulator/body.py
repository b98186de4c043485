"""The wearer of a virtual BioHarness 3: signals as pure functions of time.

Nothing here has a state. A beat's phase is a closed form of time (a heart rate
that respiration modulates), so any sample can be computed without those before
it, and a test can ask for the truth of a packet that was never sent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import cos, pi, radians, sin
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.devices.zephyr.simulator.wire import WAVEFORMS, Packet

CENTRE_COUNTS = 512
COUNTS_PER_G = 20.75
SINUS_ARRHYTHMIA = 0.05
"""Relative swing of the heart rate with respiration."""
BREATHING_SWING_COUNTS = 60
SDNN_WINDOW_BEATS = 300

_MAX_COUNTS = 1023
_COUNTS = frozenset({Packet.ECG, Packet.BREATHING, Packet.ACCELERATION})
# Standard deviation in the packet's own unit; an interval is exact.
_NOISE: Mapping[Packet, float] = MappingProxyType(
    {
        Packet.ECG: 1.0,
        Packet.BREATHING: 0.7,
        Packet.RR: 0.0,
        Packet.ACCELERATION: 0.4,
        Packet.ACCELERATION_100MG: 0.2,
    }
)
# Height [counts], centre and width [s] at one beat a second: P, Q, R, S, T.
_ECG_WAVES = (
    (15, -0.17, 0.025),
    (-12, -0.035, 0.010),
    (130, 0.0, 0.011),
    (-25, 0.035, 0.011),
    (32, 0.26, 0.045),
)

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Body:
    """A wearer with a steady mean heart rate, respiration and posture.

    Parameters
    ----------
    seed
        Of all noise; equal seeds give equal bodies.
    heart_rate_bpm, respiration_rate_bpm
        Mean rates [1/min].
    posture_deg
        Forward lean, 0 = upright [deg].
    """

    seed: int = 0
    heart_rate_bpm: float = 72.0
    respiration_rate_bpm: float = 15.0
    posture_deg: float = 10.0

    def rng(self, packet: Packet, index: int, purpose: int) -> np.random.Generator:
        """Return the random numbers of one packet, the same whenever asked for."""
        return np.random.default_rng((self.seed, packet, index, purpose))

    def samples(self, packet: Packet, index: int) -> Integers:
        """Return the samples of the ``index``-th packet of a waveform kind.

        Returns
        -------
        ndarray of int64, shape (samples, channels)
            10-bit counts (centre 512); signed 0.1 g for the 100 mg packet; signed
            ms for R-to-R.
        """
        layout = WAVEFORMS[packet]
        position = index * layout.samples + np.arange(layout.samples)
        t = np.asarray(position * (layout.period_ms / 1000), np.float64)
        signals: Mapping[Packet, Callable[[Floats], Floats]] = {
            Packet.ECG: self._ecg,
            Packet.BREATHING: self._breathing,
            Packet.RR: self._rr,
            Packet.ACCELERATION: self._acceleration,
            Packet.ACCELERATION_100MG: self._acceleration_100mg,
        }
        values = signals[packet](t).reshape(layout.samples, layout.channels)
        values = values + self.rng(packet, index, 0).normal(0, _NOISE[packet], values.shape)
        if packet in _COUNTS:
            values = np.clip(values, 0, _MAX_COUNTS)
        return np.rint(values).astype(np.int64)

    def heart_rate_at(self, t: float) -> float:
        """Return the momentary heart rate at ``t`` [s] in 1/min."""
        swing = SINUS_ARRHYTHMIA * sin(self._breath_omega * t)
        return self.heart_rate_bpm * (1 + swing)

    def sdnn_ms(self, t: float) -> float:
        """Return the standard deviation of the last 300 beat intervals at ``t`` [ms]."""
        last = np.floor(self._beat_phase(np.array([t], np.float64)))[0]
        beats = last - np.arange(SDNN_WINDOW_BEATS, -1, -1, dtype=np.float64)
        return float(np.std(np.diff(self._beat_time(beats)), ddof=1) * 1000)

    @property
    def _breath_omega(self) -> float:
        return 2 * pi * self.respiration_rate_bpm / 60

    def _beat_phase(self, t: Floats) -> Floats:
        """Return how many beats there were until ``t`` [s]: the rate, integrated."""
        omega = self._breath_omega
        return self.heart_rate_bpm / 60 * (t + SINUS_ARRHYTHMIA / omega * (1 - np.cos(omega * t)))

    def _beat_time(self, beats: Floats) -> Floats:
        """Return when beats happen [s]: `_beat_phase` inverted by fixed-point iteration."""
        omega = self._breath_omega
        unmodulated = beats * 60 / self.heart_rate_bpm
        t = unmodulated
        for _ in range(12):  # each step shrinks the error by the arrhythmia's swing, 0.05
            t = unmodulated - SINUS_ARRHYTHMIA / omega * (1 - np.cos(omega * t))
        return t

    def _ecg(self, t: Floats) -> Floats:
        phase = self._beat_phase(t)
        swing = SINUS_ARRHYTHMIA * np.sin(self._breath_omega * t)
        interval_s = 60 / (self.heart_rate_bpm * (1 + swing))
        from_peak_s = (phase - np.rint(phase)) * interval_s
        stretch = np.sqrt(interval_s)  # QT follows the square root of R-R (Bazett)
        ecg = np.full(t.shape, float(CENTRE_COUNTS))
        for height, centre_s, width_s in _ECG_WAVES:
            ecg += height * np.exp(-0.5 * ((from_peak_s - centre_s * stretch) / width_s) ** 2)
        return ecg

    def _breathing(self, t: Floats) -> Floats:
        return CENTRE_COUNTS + BREATHING_SWING_COUNTS * np.sin(self._breath_omega * t)

    def _rr(self, t: Floats) -> Floats:
        beat = np.floor(self._beat_phase(t))
        interval_ms = np.rint(1000 * (self._beat_time(beat) - self._beat_time(beat - 1)))
        return np.where(beat % 2 == 0, interval_ms, -interval_ms)

    def _gravity_g(self, t: Floats) -> Floats:
        lean = radians(self.posture_deg)
        return np.tile([-cos(lean), 0.0, sin(lean)], (t.size, 1))

    def _acceleration(self, t: Floats) -> Floats:
        return CENTRE_COUNTS + COUNTS_PER_G * self._gravity_g(t)

    def _acceleration_100mg(self, t: Floats) -> Floats:
        return 10 * self._gravity_g(t)
