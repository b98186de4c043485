"""Recognises respiration belts by their advertisements."""

from __future__ import annotations

from biosensor_gateway.devices.discovery import Found
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

KIND = "GDX-RB"
ADVICE = (
    "press its button until its Bluetooth light blinks red, and end its connection to other apps"
)


def identify(seen: Advertisement) -> str | None:
    """Return a belt's serial number from the name ``GDX-RB <serial>``; None for other devices."""
    model, _, serial = seen.name.partition(" ")
    return serial.strip() if model == KIND else None


def recognise(seen: Advertisement | SerialPort) -> Found | None:
    """Tell whether this is a belt."""
    if not isinstance(seen, Advertisement):
        return None
    serial = identify(seen)
    if serial is None:
        return None
    settings = {"unit": serial or seen.address, "device": seen.address}
    return Found("vernier_respiration_belt", seen.name, settings, seen.rssi_dbm)
