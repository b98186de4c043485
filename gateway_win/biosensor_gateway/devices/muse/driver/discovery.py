"""Recognises Muse headbands by their advertisements."""

from __future__ import annotations

import re

from biosensor_gateway.devices.discovery import Found
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

KIND = "Muse"
ADVICE = "switch it on (its lights run), and end its connection to phones and other programs"
_NAME = re.compile(r"Muse(?:S|Athena| Athena)?-(?P<number>\w+)")


def identify(seen: Advertisement) -> str | None:
    """Return the digits of a name like ``Muse-3A1F`` or ``MuseS-3A1F``; None for other devices."""
    found = _NAME.fullmatch(seen.name.strip())
    return found["number"] if found else None


def recognise(seen: Advertisement | SerialPort) -> Found | None:
    """Tell whether this is a Muse."""
    if not isinstance(seen, Advertisement):
        return None
    number = identify(seen)
    if number is None:
        return None
    settings = {"unit": number, "device": seen.address}
    return Found("muse", seen.name, settings, seen.rssi_dbm)
