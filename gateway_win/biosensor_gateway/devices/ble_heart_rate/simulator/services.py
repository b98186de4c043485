"""The GATT services of a virtual strap, and its heart rate measurement."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle, islice
from typing import NamedTuple

from bumble.att import Attribute
from bumble.core import UUID
from bumble.device import Connection
from bumble.gatt import Characteristic, CharacteristicValue, Service

# Layout: Bluetooth SIG, Heart Rate Service 1.0, section 3.1.
RR_TICKS_PER_S = 1024
_WIDE = 0x01
_CONTACT = 0x02
_CONTACT_SUPPORTED = 0x04
_INTERVALS = 0x10
# Each value ends inside a field announced by its flags.
_DAMAGED = ("", "10", "00", "0148", "184800", "0848", "1f2c01", "0d48", "0948", "01")


class HeartRateMeasurement(NamedTuple):
    """One measurement."""

    bpm: int  # Heart rate [1/min]; 0 if there is none.
    # R-R intervals [1/1024 s], oldest first; None for a device that never sends any.
    rr: Sequence[int] | None = None
    contact: bool | None = None  # Skin contact; None for a device that does not report it.


def encode(measurement: HeartRateMeasurement) -> bytes:
    """Return the characteristic's value."""
    wide = measurement.bpm > 0xFF
    flags = _WIDE * wide
    if measurement.contact is not None:
        flags |= _CONTACT_SUPPORTED | _CONTACT * measurement.contact
    fields = struct.pack("<H" if wide else "B", measurement.bpm)
    if measurement.rr is not None:
        flags |= _INTERVALS
        fields += struct.pack(f"<{len(measurement.rr)}H", *measurement.rr)
    return bytes((flags,)) + fields


def damaged(count: int) -> Iterator[bytes]:
    """Return values that are too short for their flags."""
    return (bytes.fromhex(text) for text in islice(cycle(_DAMAGED), count))


CHEST = 1
"""Value of the Body Sensor Location characteristic (0x2A38)."""
_READABLE = Attribute.Permissions.READABLE
_READ = Characteristic.Properties.READ
_NOTIFY = Characteristic.Properties.NOTIFY


@dataclass(frozen=True)
class Identity:
    """Contents of the Device Information service (0x180A)."""

    # manufacturer, model, serial_number, hardware, firmware, software: empty = the device does not
    # have this characteristic.
    manufacturer: str
    model: str
    serial_number: str
    hardware: str = ""
    firmware: str = ""
    software: str = ""

    def service(self) -> Service:
        """Return the service with these texts."""
        texts = {
            0x2A29: self.manufacturer,
            0x2A24: self.model,
            0x2A25: self.serial_number,
            0x2A27: self.hardware,
            0x2A26: self.firmware,
            0x2A28: self.software,
        }
        characteristics = [
            _characteristic(number, _READ, text.encode()) for number, text in texts.items() if text
        ]
        return Service(UUID.from_16_bits(0x180A), characteristics)


class HeartRateService:
    """Service 0x180D.

    Parameters
    ----------
    location
        Value of the Body Sensor Location characteristic.
    """

    def __init__(self, location: int = CHEST) -> None:
        self.measurement = _characteristic(0x2A37, _NOTIFY)  # The characteristic to notify.
        where = _characteristic(0x2A38, _READ, bytes((location,)))
        self.service = Service(UUID.from_16_bits(0x180D), [self.measurement, where])

    def demand_pairing(self) -> None:
        """Allow only a paired host to subscribe to the measurement."""
        self.measurement.permissions |= Attribute.Permissions.WRITE_REQUIRES_AUTHENTICATION


class BatteryService:
    """Service 0x180F.

    Parameters
    ----------
    read
        Called when a host reads the level; returns the level [percent].
    """

    def __init__(self, read: Callable[[], int]) -> None:
        def answer(_connection: Connection) -> bytes:
            return bytes((read(),))

        # The characteristic to notify.
        self.level = _characteristic(0x2A19, _READ | _NOTIFY, CharacteristicValue(read=answer))
        self.service = Service(UUID.from_16_bits(0x180F), [self.level])


def _characteristic(
    number: int,
    properties: Characteristic.Properties,
    value: CharacteristicValue[bytes] | bytes = b"",
) -> Characteristic[bytes]:
    return Characteristic(UUID.from_16_bits(number), properties, _READABLE, value)
