"""The differences between one virtual Polar sensor and the next."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, unique

from biosensor_gateway.devices.polar_h10.simulator.pmd import FULL_MTU, Measurement


@unique
class Firmware(Enum):
    """Which services the firmware has for measurement data."""

    CURRENT = "current"
    """The PMD service."""
    OLD = "old"
    """The file transfer service alone, as an H10 before its update."""
    HEART_RATE_ONLY = "heart_rate_only"
    """Neither, as an H9."""


@dataclass(frozen=True)
class Quirks:
    """Properties that firmware or circumstances give to a sensor.

    Attributes
    ----------
    demands_pairing
        The control point answers ATT error 0x05 until the host has paired.
    left_streaming
        Measurements that a former host left on; they run from the first power-on.
    keeps_streaming
        Measurements go on when the link is lost.
    announces_stops
        A stop on command is followed by the packet that tells of a stop by the device.
    short_errors
        Replies of failure end after their status.
    max_mtu
        The largest ATT MTU that it grants.
    minimum_mtu
        A start over a link with a smaller ATT MTU is answered with INVALID_MTU.
    compressed_acceleration
        Acceleration is sent compressed, in mg.
    sampling_deviation
        By which fraction the true sampling rates, in the device's time, are higher than
        nominal; the data sheet allows 0.02.
    first_sample_s
        From a start to its first sample.
    first_intervals_s
        From a start to the first intervals between pulse waves; 25 s by the vendor's documents.
    """

    firmware: Firmware = Firmware.CURRENT
    demands_pairing: bool = False
    left_streaming: tuple[Measurement, ...] = ()
    keeps_streaming: bool = False
    announces_stops: bool = False
    short_errors: bool = False
    max_mtu: int = FULL_MTU
    minimum_mtu: int = 0
    compressed_acceleration: bool = False
    sampling_deviation: float = 0.0
    first_sample_s: float = 0.0
    first_intervals_s: float = 25.0
