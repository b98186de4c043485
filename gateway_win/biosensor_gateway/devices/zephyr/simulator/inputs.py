"""Signals that electrodes, strap and converters of a BioHarness make of its wearer.

Times are seconds of the device's own clock since power-on, which is the wearer's time here:
numbers of samples count it. Nothing has a state, so a test can ask for the truth of a packet
that was never sent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import atan2, degrees
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.devices.zephyr.simulator.wire import WAVEFORMS, Packet
from biosensor_gateway.simulation.wearer import Wearer

CENTRE_COUNTS = 512
COUNTS_PER_G = 20.75
BREATHING_SWING_COUNTS = 60
SDNN_WINDOW_BEATS = 300

_MAX_COUNTS = 1023
_COUNTS = frozenset({Packet.ECG, Packet.BREATHING, Packet.ACCELERATION})
_UV_PER_COUNT = 8.0
# The strap swings by `BREATHING_SWING_COUNTS` where the wearer's chest pulls 12 N +- 3 N.
_RESTING_FORCE_N, _COUNTS_PER_N = 12.0, BREATHING_SWING_COUNTS / 3
# Standard deviation in the packet's own unit; an interval is exact.
_CONVERTER_NOISE: Mapping[Packet, float] = MappingProxyType(
    {
        Packet.ECG: 0.5,
        Packet.BREATHING: 0.5,
        Packet.RR: 0.0,
        Packet.ACCELERATION: 0.4,
        Packet.ACCELERATION_100MG: 0.2,
    }
)

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class Inputs:
    """A wearer as the device's converters see them."""

    def __init__(self, wearer: Wearer) -> None:
        self._wearer = wearer

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
        rng = np.random.default_rng((self._wearer.seed, packet, index))
        values = values + rng.normal(0, _CONVERTER_NOISE[packet], values.shape)
        if packet in _COUNTS:
            values = np.clip(values, 0, _MAX_COUNTS)
        return np.rint(values).astype(np.int64)

    @property
    def respiration_rate_bpm(self) -> float:
        """The respiration rate in 0.1 / min."""
        return round(self._wearer.respiration_rate_bpm, 1)

    def heart_rate_bpm(self, t: float) -> int:
        """Return the momentary heart rate at ``t`` [s] in 1/min."""
        return round(self._wearer.heart_rate(_one(t))[0])

    def sdnn_ms(self, t: float) -> int:
        """Return the standard deviation of the last 300 beat intervals at ``t`` [ms]."""
        last = np.floor(self._wearer.beat_count(_one(t)))[0]
        beats = last - np.arange(SDNN_WINDOW_BEATS, -1, -1, dtype=np.float64)
        return round(np.std(np.diff(self._wearer.beat_time(beats)), ddof=1) * 1000)

    def posture_deg(self, t: float) -> int:
        """Return the forward lean at ``t`` [s] in degrees, 0 = upright."""
        vertical, _, sagittal = self._wearer.acceleration_g(_one(t))[0]
        return round(degrees(atan2(sagittal, -vertical)))

    def _ecg(self, t: Floats) -> Floats:
        return CENTRE_COUNTS + self._wearer.ecg_uv(t) / _UV_PER_COUNT

    def _breathing(self, t: Floats) -> Floats:
        return CENTRE_COUNTS + _COUNTS_PER_N * (self._wearer.chest_force_n(t) - _RESTING_FORCE_N)

    def _rr(self, t: Floats) -> Floats:
        beat = np.floor(self._wearer.beat_count(t))
        interval_ms = np.rint(1000 * self._wearer.rr_before(self._wearer.beat_time(beat)))
        return np.where(beat % 2 == 0, interval_ms, -interval_ms)

    def _acceleration(self, t: Floats) -> Floats:
        return CENTRE_COUNTS + COUNTS_PER_G * self._wearer.acceleration_g(t)

    def _acceleration_100mg(self, t: Floats) -> Floats:
        return 10 * self._wearer.acceleration_g(t)


def _one(t: float) -> Floats:
    return np.array([t], np.float64)
