"""Says which streams have a topic of ``sensor_msgs`` beside their own, and by what data name.

What a channel means is read from its role in the header, so a new sensor gets them too.
"""

from __future__ import annotations

from biosensor_common.quantities import (
    ACCELERATION,
    MAGNETIC_FIELD,
    ORIENTATION,
    ChannelRole,
    ContentType,
    Unit,
)
from biosensor_common.stream_header import StreamHeader

STANDARD_GRAVITY = 9.80665
"""In m/s², exactly (3rd General Conference on Weights and Measures, 1901)."""

_BATTERY_AMONG_OTHERS = "bat_state"


def temperature(header: StreamHeader) -> str:
    """Return ``<data>_temperature``, empty if the stream is none."""
    fits = header.content_type == ContentType.TEMPERATURE and header.units == (Unit.CELSIUS,)
    return f"{header.data_name}_temperature" if fits else ""


def battery_state(header: StreamHeader) -> str:
    """Return ``<data>_state`` of the charge alone, ``bat_state`` of one among others, or empty."""
    if ChannelRole.STATE_OF_CHARGE not in header.roles:
        return ""
    return f"{header.data_name}_state" if len(header.roles) == 1 else _BATTERY_AMONG_OTHERS


def imu(header: StreamHeader) -> str:
    """Return ``<data>_imu`` of orientation with acceleration, else empty."""
    has_it = {*ORIENTATION, *ACCELERATION} <= set(header.roles)
    return f"{header.data_name}_imu" if has_it else ""


def magnetic_field(header: StreamHeader) -> str:
    """Return ``<data>_mag`` of a magnetic field in three axes, else empty."""
    return f"{header.data_name}_mag" if set(MAGNETIC_FIELD) <= set(header.roles) else ""
