"""Recognises Polar sensors by their advertisements."""

from __future__ import annotations

from collections.abc import Collection

from biosensor_gateway.devices.ble_heart_rate.driver.protocol import HEART_RATE_SERVICE
from biosensor_gateway.devices.discovery import Found
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

MANUFACTURER_ID = 0x006B
_MODELS = frozenset({"H10"})


def identify(seen: Advertisement, models: Collection[str] = _MODELS) -> str | None:
    """Return the id printed on a sensor of these models, None for anything else.

    Its name is ``Polar <model> <id>``, which comes in the scan response only.
    """
    words = seen.name.split()
    if len(words) < 3 or words[0] != "Polar" or " ".join(words[1:-1]) not in models:
        return None
    is_polar = MANUFACTURER_ID in seen.manufacturer_data or HEART_RATE_SERVICE in seen.service_uuids
    return words[-1] if is_polar else None


def recognise(seen: Advertisement | SerialPort) -> Found | None:
    """Tell whether this is an H10."""
    identity = identify(seen) if isinstance(seen, Advertisement) else None
    if not isinstance(seen, Advertisement) or identity is None:
        return None
    settings = {"unit": identity, "device": seen.address}
    return Found("polar_h10", seen.name.strip(), settings, seen.rssi_dbm)
