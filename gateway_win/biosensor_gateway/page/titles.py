"""Names for people of kinds of sensors."""

from __future__ import annotations

from biosensor_common.errors import SpecError
from biosensor_gateway.devices.registry import declaration


def title_of(sensor: str) -> str:
    """Return what people call a kind of sensor; its name, if it is unknown."""
    try:
        return declaration(sensor).title
    except SpecError:
        return sensor
