"""The GATT services of a heart-rate strap."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from bumble.att import Attribute
from bumble.core import UUID
from bumble.device import Connection
from bumble.gatt import Characteristic, CharacteristicValue, Service

CHEST = 1
"""Value of the Body Sensor Location characteristic (0x2A38)."""
_READABLE = Attribute.Permissions.READABLE
_READ = Characteristic.Properties.READ
_NOTIFY = Characteristic.Properties.NOTIFY


@dataclass(frozen=True)
class Identity:
    """What the Device Information service (0x180A) says.

    Attributes
    ----------
    manufacturer, model, serial_number, hardware, firmware, software
        Empty = the device does not have this characteristic.
    """

    manufacturer: str
    model: str
    serial_number: str
    hardware: str = ""
    firmware: str = ""
    software: str = ""

    def service(self) -> Service:
        """Describe the service."""
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

    Attributes
    ----------
    measurement
        The characteristic to notify.
    """

    def __init__(self, location: int = CHEST) -> None:
        self.measurement = _characteristic(0x2A37, _NOTIFY)
        where = _characteristic(0x2A38, _READ, bytes((location,)))
        self.service = Service(UUID.from_16_bits(0x180D), [self.measurement, where])

    def demand_pairing(self) -> None:
        """Let only a host that has paired subscribe to the measurement."""
        self.measurement.permissions |= Attribute.Permissions.WRITE_REQUIRES_AUTHENTICATION


class BatteryService:
    """Service 0x180F.

    Parameters
    ----------
    read
        Called when a host reads the level; returns it [percent].

    Attributes
    ----------
    level
        The characteristic to notify.
    """

    def __init__(self, read: Callable[[], int]) -> None:
        def answer(_connection: Connection) -> bytes:
            return bytes((read(),))

        self.level = _characteristic(0x2A19, _READ | _NOTIFY, CharacteristicValue(read=answer))
        self.service = Service(UUID.from_16_bits(0x180F), [self.level])


def _characteristic(
    number: int,
    properties: Characteristic.Properties,
    value: CharacteristicValue[bytes] | bytes = b"",
) -> Characteristic[bytes]:
    return Characteristic(UUID.from_16_bits(number), properties, _READABLE, value)
