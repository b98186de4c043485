"""Devices as a search finds them, with the settings that would add each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


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
