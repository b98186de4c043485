"""Recognises Movesense sensors by their advertisements."""

from __future__ import annotations

from biosensor_gateway.devices.discovery import Found
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

KIND = "Movesense"
ADVICE = (
    "snap it into its strap and put that on with wet electrodes, and end its connection to "
    "phones and other programs"
)


def identify(seen: Advertisement) -> str | None:
    """Return the serial number from the name ``Movesense <serial>``; None for other devices."""
    kind, _, serial = seen.name.strip().partition(" ")
    return serial.strip() if kind == KIND else None


def recognise(seen: Advertisement | SerialPort) -> Found | None:
    """Tell whether this is a Movesense sensor."""
    if not isinstance(seen, Advertisement):
        return None
    serial = identify(seen)
    if serial is None:
        return None
    settings = {"unit": serial or seen.address, "device": seen.address}
    return Found("movesense", seen.name, settings, seen.rssi_dbm)
