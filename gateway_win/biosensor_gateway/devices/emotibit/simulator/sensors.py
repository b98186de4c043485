"""The sensors on an EmotiBit: each samples by its own oscillator, and is read now and then.

Samples wait in the sensor's buffer until the processor looks, 75 times a second; all that it
finds gets the processor's time of that moment, in whole milliseconds. Source:
EmotiBit_FeatherWing, ``EmotiBit.cpp`` and ``BufferFloat.cpp``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import ceil, pi

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.simulation.wearer import Wearer

Floats = NDArray[np.float64]

READ_EVERY_S = 1 / 75
_PULSE_COUNTS, _PULSE_SWING = 110_000.0, 1500.0
_DEPTHS = (1.0, 0.6, 0.3)
"""How far infrared, red and green light swing with the pulse."""


@dataclass(frozen=True, slots=True)
class Part:
    """A sensor.

    Attributes
    ----------
    data_name
        Of the declaration.
    tags
        Of the packets of its channels.
    rate_hz
        Nominal.
    fast_ppm
        How much its own oscillator is off.
    measure
        Values at times of the wearer, shape (n, channels), as its packets print them.
    """

    data_name: str
    tags: tuple[str, ...]
    rate_hz: float
    fast_ppm: float
    measure: Callable[[Wearer, Floats], Floats]

    @property
    def period_s(self) -> float:
        """Seconds of the device between two samples."""
        return 1 / (self.rate_hz * (1 + self.fast_ppm * 1e-6))


@dataclass(slots=True)
class Reading:
    """What is in one sensor's buffer of the processor, until it is sent.

    Attributes
    ----------
    stamps_ms
        Of when each sample was read.
    times_s
        When each sample was measured, device seconds.
    """

    stamps_ms: list[int] = field(default_factory=list[int])
    times_s: list[float] = field(default_factory=list[float])


class Sampler:
    """The samples of one sensor since it was switched on."""

    def __init__(self, part: Part) -> None:
        self.part = part
        self._next = 1

    def read(self, before_s: float, now_s: float, into: Reading) -> None:
        """Move samples into a buffer at each time that the processor looks.

        Parameters
        ----------
        before_s, now_s
            Device seconds; the processor looks several times between them.
        """
        first = ceil(before_s / READ_EVERY_S)
        for look in range(first, ceil(now_s / READ_EVERY_S)):
            self._read_at(look * READ_EVERY_S, into)

    def _read_at(self, look_s: float, into: Reading) -> None:
        while (at := self._next * self.part.period_s) <= look_s:
            into.times_s.append(at)
            into.stamps_ms.append(int(look_s * 1000))
            self._next += 1


def _conductance(wearer: Wearer, t: Floats) -> Floats:
    return wearer.skin_conductance_us(t)[:, np.newaxis]


def _pulse(wearer: Wearer, t: Floats) -> Floats:
    swing = _PULSE_SWING * wearer.pulse(t)[:, np.newaxis]
    return np.round(_PULSE_COUNTS - swing * np.array(_DEPTHS, np.float64))


def _temperature(wearer: Wearer, t: Floats) -> Floats:
    return wearer.skin_temperature_c(t)[:, np.newaxis]


def _acceleration(wearer: Wearer, t: Floats) -> Floats:
    return wearer.acceleration_g(t)


def _rotation(wearer: Wearer, t: Floats) -> Floats:
    axes = [2.0 * np.sin(2 * pi * 0.3 * t + k) + wearer.noise(t, 0.2, f"r{k}") for k in range(3)]
    return np.stack(axes, axis=1)


def _field(wearer: Wearer, t: Floats) -> Floats:
    axes = [level + wearer.noise(t, 0.4, f"m{level:g}") for level in (21.0, -4.0, -43.0)]
    return np.stack(axes, axis=1)


def parts(ppg_hz: float) -> tuple[Part, ...]:
    """Return the sensors of an EmotiBit V5 with stock firmware, but for the pulse's rate."""
    return (
        Part("eda", ("EA",), 15.0, 0.0, _conductance),
        Part("ppg", ("PI", "PR", "PG"), ppg_hz, 900.0, _pulse),
        Part("st", ("T1",), 7.5, 0.0, _temperature),
        Part("acc", ("AX", "AY", "AZ"), 25.0, -1200.0, _acceleration),
        Part("gyro", ("GX", "GY", "GZ"), 25.0, -1200.0, _rotation),
        Part("mag", ("MX", "MY", "MZ"), 25.0, -1200.0, _field),
    )
