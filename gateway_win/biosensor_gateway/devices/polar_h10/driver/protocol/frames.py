"""Data frames, by what they hold; `layouts` reads them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, unique
from math import nan

from biosensor_gateway.devices.polar_h10.driver.protocol.compression import Sample

DATA = "fb005c82-02e7-f387-1cad-8acd2d8df0c8"

_COMPRESSED = 0x80
_MICROTESLA_PER_GAUSS = 100.0
PPG_CHANNELS = 4


@dataclass(frozen=True, slots=True)
class Header:
    """What every frame starts with.

    Attributes
    ----------
    measurement
        One of `Measurement`, or an unknown number.
    timestamp_ns
        Device clock at the last sample [ns since 2000-01-01, as far as it was ever set].
    frame_type
        Layout of the samples; from 0x80 on compressed.
    """

    measurement: int
    timestamp_ns: int
    frame_type: int

    @property
    def compressed(self) -> bool:
        """Whether the samples are delta-compressed."""
        return self.frame_type >= _COMPRESSED


@dataclass(frozen=True, slots=True)
class Ecg:
    """Electrocardiogram [uV]."""

    header: Header
    microvolts: tuple[int, ...]

    @property
    def samples(self) -> list[list[float]]:
        """One channel [uV]."""
        return [[value] for value in self.microvolts]


@dataclass(frozen=True, slots=True)
class Acceleration:
    """Acceleration, x y z [counts].

    Polar's SDK cuts off what it makes of compressed counts to whole mg; here, they
    keep their resolution.
    """

    header: Header
    counts: tuple[Sample, ...]
    g_per_count: float

    @property
    def samples(self) -> list[list[float]]:
        """Three channels [g]."""
        return _scaled(self.counts, self.g_per_count)


@dataclass(frozen=True, slots=True)
class Rotation:
    """Angular velocity, x y z [counts]."""

    header: Header
    counts: tuple[Sample, ...]
    degrees_per_s_per_count: float

    @property
    def samples(self) -> list[list[float]]:
        """Three channels [deg/s]."""
        return _scaled(self.counts, self.degrees_per_s_per_count)


@dataclass(frozen=True, slots=True)
class MagneticField:
    """Magnetic flux density, x y z [counts]."""

    header: Header
    counts: tuple[Sample, ...]
    gauss_per_count: float

    @property
    def samples(self) -> list[list[float]]:
        """Three channels [uT]."""
        return _scaled(self.counts, self.gauss_per_count * _MICROTESLA_PER_GAUSS)


@dataclass(frozen=True, slots=True)
class Ppg:
    """Photoplethysmogram [counts]: three LEDs and the ambient light, or two LEDs alone."""

    header: Header
    counts: tuple[Sample, ...]

    @property
    def samples(self) -> list[list[float]]:
        """Four channels [counts]; NaN of those that the device does not have."""
        return [[*each, *(nan,) * (PPG_CHANNELS - len(each))] for each in self.counts]


@dataclass(frozen=True, slots=True)
class PulseInterval:
    """Interval between two pulse waves, as an optical sensor sees them.

    Attributes
    ----------
    bpm
    interval_ms, error_ms
        The interval and the device's estimate of its error.
    moved
        The device calls the interval invalid because of movement.
    contact
        Whether the skin is felt; None if the device does not tell.
    """

    bpm: int
    interval_ms: int
    error_ms: int
    moved: bool
    contact: bool | None

    @property
    def is_valid(self) -> bool:
        """Whether the device vouches for it."""
        return not self.moved and self.contact is not False


@dataclass(frozen=True, slots=True)
class PulseIntervals:
    """Intervals between pulse waves, oldest first."""

    header: Header
    intervals: tuple[PulseInterval, ...]


RegularFrame = Ecg | Acceleration | Rotation | MagneticField | Ppg
"""Frames of samples at a constant rate."""
Frame = RegularFrame | PulseIntervals


@unique
class Rejected(Enum):
    """Why a frame holds no samples."""

    DAMAGED = "damaged"
    """It is cut short, or its lengths do not fit."""
    UNKNOWN = "unknown"
    """Its layout is none that is known."""


def _scaled(counts: tuple[Sample, ...], unit: float) -> list[list[float]]:
    return [[count * unit for count in sample] for sample in counts]
