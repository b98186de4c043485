"""Recognises the Polar sensors that this driver is made for by their advertisements."""

from __future__ import annotations

from biosensor_gateway.devices.ble_heart_rate.driver.protocol import HEART_RATE_SERVICE
from biosensor_gateway.devices.discovery import Found
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

MANUFACTURER_ID = 0x006B
_MODELS = frozenset({"H10", "Sense", "Verity Sense", "OH1"})
"""Those with the PMD service; the others are plain heart-rate straps."""


def identify(seen: Advertisement) -> str | None:
    """Return the id printed on an H10, Verity Sense or OH1, None for anything else.

    Its name is ``Polar <model> <id>``, which comes in the scan response only.
    """
    words = seen.name.split()
    if len(words) < 3 or words[0] != "Polar" or " ".join(words[1:-1]) not in _MODELS:
        return None
    is_polar = MANUFACTURER_ID in seen.manufacturer_data or HEART_RATE_SERVICE in seen.service_uuids
    return words[-1] if is_polar else None


def recognise(seen: Advertisement | SerialPort) -> Found | None:
    """Tell whether this is such a sensor."""
    identity = identify(seen) if isinstance(seen, Advertisement) else None
    if not isinstance(seen, Advertisement) or identity is None:
        return None
    settings = {"unit": identity, "device": seen.address}
    return Found("polar_h10", seen.name.strip(), settings, seen.rssi_dbm)
