"""Recognises Polar's optical sensors by their advertisements."""

from __future__ import annotations

from biosensor_gateway.devices.discovery import Found
from biosensor_gateway.devices.polar_h10.driver import discovery as polar
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

MODELS = frozenset({"Sense", "Verity Sense", "OH1", "360"})
"""As they advertise: a Verity Sense is a ``Polar Sense``."""


def identify(seen: Advertisement) -> str | None:
    """Return the id printed on a Verity Sense, an OH1 or a 360, None for anything else."""
    return polar.identify(seen, MODELS)


def recognise(seen: Advertisement | SerialPort) -> Found | None:
    """Tell whether this is such a sensor."""
    identity = identify(seen) if isinstance(seen, Advertisement) else None
    if not isinstance(seen, Advertisement) or identity is None:
        return None
    settings = {"unit": identity, "device": seen.address}
    return Found("polar_verity_sense", seen.name.strip(), settings, seen.rssi_dbm)
