"""Recognises heart-rate straps by their advertisements."""

from __future__ import annotations

from biosensor_gateway.devices.ble_heart_rate.driver.protocol import HEART_RATE_SERVICE
from biosensor_gateway.devices.discovery import Found
from biosensor_gateway.transports.nearby import Advertisement, SerialPort


def identify(seen: Advertisement) -> str | None:
    """Return the address of a device that advertises the Heart Rate service, else None."""
    return seen.address if HEART_RATE_SERVICE in seen.service_uuids else None


def identify_any(seen: Advertisement) -> str | None:
    """Return the address of any device: some straps do not say that they are one."""
    return seen.address


def recognise(seen: Advertisement | SerialPort) -> Found | None:
    """Tell whether this is a strap; one that another driver knows better is left to that one."""
    if not isinstance(seen, Advertisement) or identify(seen) is None:
        return None
    settings = {"unit": seen.address, "device": seen.address}
    return Found("ble_heart_rate", seen.name or seen.address, settings, seen.rssi_dbm)
