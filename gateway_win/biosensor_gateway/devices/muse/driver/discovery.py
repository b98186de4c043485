"""Recognises Muse headbands by their advertisements."""

from __future__ import annotations

import re

from biosensor_gateway.devices.discovery import Found
from biosensor_gateway.devices.muse.driver.gatt import SERVICE
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

KIND = "Muse"
ADVICE = "switch it on (its lights run), and end its connection to phones and other programs"
_NAME = re.compile(r"Muse(?:S|Athena| Athena)?-(?P<number>\w+)")

_SEPARATORS = re.compile(r"[^0-9A-Fa-f]")


def identify(seen: Advertisement) -> str | None:
    """Return the digits of a name like ``Muse-3A1F`` or ``MuseS-3A1F``; None for other devices.

    Some headbands advertise no name: their service tells them, and nothing their digits.
    """
    if not seen.name.strip():
        return "" if SERVICE in seen.service_uuids else None
    found = _NAME.fullmatch(seen.name.strip())
    return found["number"] if found else None


def recognise(seen: Advertisement | SerialPort) -> Found | None:
    """Tell whether this is a Muse."""
    if not isinstance(seen, Advertisement):
        return None
    number = identify(seen)
    if number is None:
        return None
    unit = number or _SEPARATORS.sub("", seen.address)[-4:]
    settings = {"unit": unit, "device": seen.address}
    return Found("muse", seen.name or f"{KIND} without a name", settings, seen.rssi_dbm)
