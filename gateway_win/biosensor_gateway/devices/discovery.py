"""Devices as a search finds them, with the settings that would add each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from biosensor_gateway.transports.nearby import Advertisement, SerialPort


@dataclass(frozen=True, slots=True)
class Found:
    """A device that could be added to the settings.

    Attributes
    ----------
    name
        What a person calls it: the advertised name, an id.
    settings
        ``unit`` and whatever else leads the driver to it; scalars only.
    """

    sensor: str
    name: str
    settings: Mapping[str, str | int | float | bool]
    rssi_dbm: int | None = None


def by_advertisement(
    sensor: str, identify: Callable[[Advertisement], str | None]
) -> Callable[[Advertisement | SerialPort], Found | None]:
    """Return what recognises a Bluetooth LE sensor among all that is within reach.

    Parameters
    ----------
    identify
        Returns what tells one device of the sensor from another, which becomes its unit; empty
        where only its address does, None for devices that are not of the sensor.
    """

    def recognise(seen: Advertisement | SerialPort) -> Found | None:
        identity = identify(seen) if isinstance(seen, Advertisement) else None
        if not isinstance(seen, Advertisement) or identity is None:
            return None
        settings = {"unit": identity or seen.address, "device": seen.address}
        return Found(sensor, seen.name.strip() or seen.address, settings, seen.rssi_dbm)

    return recognise
