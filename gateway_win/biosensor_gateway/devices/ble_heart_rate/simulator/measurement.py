"""The Heart Rate Measurement characteristic (0x2A37) as a device writes it.

Layout: Bluetooth SIG, Heart Rate Service 1.0, section 3.1.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from itertools import cycle, islice
from typing import NamedTuple

RR_TICKS_PER_S = 1024
_WIDE = 0x01
_CONTACT = 0x02
_CONTACT_SUPPORTED = 0x04
_ENERGY = 0x08
_INTERVALS = 0x10
# Each ends within a field that its flags promise.
_DAMAGED = ("", "10", "00", "0148", "184800", "0848", "1f2c01", "0d48", "0948", "01")


class HeartRateMeasurement(NamedTuple):
    """One measurement.

    Attributes
    ----------
    bpm
        Heart rate [1/min]; 0 where there is none.
    rr
        R-R intervals [1/1024 s], oldest first; None of a device that sends none at all.
    contact
        None of a device that does not tell.
    energy_kj
        Energy expended since the last reset [kJ], None if not sent.
    """

    bpm: int
    rr: Sequence[int] | None = None
    contact: bool | None = None
    energy_kj: int | None = None


def encode(measurement: HeartRateMeasurement, *, wide: bool = False) -> bytes:
    """Return the characteristic's value.

    Parameters
    ----------
    wide
        Write the rate in two bytes even if one would do.
    """
    wide = wide or measurement.bpm > 0xFF
    flags = _WIDE * wide
    if measurement.contact is not None:
        flags |= _CONTACT_SUPPORTED | _CONTACT * measurement.contact
    fields = struct.pack("<H" if wide else "B", measurement.bpm)
    if measurement.energy_kj is not None:
        flags |= _ENERGY
        fields += struct.pack("<H", measurement.energy_kj)
    if measurement.rr is not None:
        flags |= _INTERVALS
        fields += struct.pack(f"<{len(measurement.rr)}H", *measurement.rr)
    return bytes((flags,)) + fields


def damaged(count: int) -> Iterator[bytes]:
    """Return so many values that are too short for their flags."""
    return (bytes.fromhex(text) for text in islice(cycle(_DAMAGED), count))
