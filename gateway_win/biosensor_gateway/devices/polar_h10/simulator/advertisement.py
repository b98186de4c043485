"""Builds the advertisement of a Polar sensor."""

from __future__ import annotations

POLAR_COMPANY_ID = 0x006B
SERVICE_UUIDS = ("180d", "feee")
"""Heart rate, and Polar's file transfer."""
_BROADCAST = 0x20


def manufacturer_data(*, battery_low: bool, contact: bool, counter: int, bpm: int) -> bytes:
    """Return the payload behind the company id.

    Parameters
    ----------
    battery_low, contact
    counter
        Of payloads; shows that the sensor is alive.
    bpm
        Heart rate, sent as fast and as slow average.
    """
    status = battery_low | contact << 1 | (counter & 7) << 2 | _BROADCAST
    return bytes((status, 0, bpm, bpm))
