"""Serialises streams as ``sensor_msgs``, in addition to their own messages.

The meaning of a channel is taken from its role in the header, so that new sensors get these
messages, too. Values are in SI units, as the messages require. By their convention, an unknown
covariance is all zeros, and a first element of -1 marks a missing quantity. The orientation of a
device's world frame is unknown, so orientation and acceleration are not rotated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_common.quantities import (
    ACCELERATION,
    MAGNETIC_FIELD,
    ORIENTATION,
    STANDARD_GRAVITY,
    ChannelRole,
    ContentType,
    Unit,
)
from biosensor_common.ros.cdr import HeadedRows, aligned, text
from biosensor_common.stream_header import StreamHeader

_FLOAT64, _FLOAT32 = np.dtype("<f8"), np.dtype("<f4")
_TESLA_PER_MICROTESLA = 1e-6
# Status, health and technology unknown; a battery is present; two empty lists of cells.
_BATTERY = bytes([0, 0, 0, 1, *bytes(8)])

_BATTERY_AMONG_OTHERS = "bat_state"

Floats = NDArray[np.float64]


class StandardMessage(NamedTuple):
    """One additional topic of a stream.

    Attributes
    ----------
    data
        Last part of the topic's name.
    fill
        Converts samples to rows of the message's values.
    rows
        Serialises these rows.
    """

    data: str
    type_name: str
    fill: Callable[[NDArray[Any]], NDArray[Any]]
    rows: HeadedRows

    def encode(self, unix_ns: NDArray[np.int64], values: NDArray[Any]) -> list[bytes]:
        """Serialise one message per sample; values have the shape (n, n_channels)."""
        return self.rows.encode(unix_ns, self.fill(values))


def standard_messages(header: StreamHeader, frame_id: str) -> list[StandardMessage]:
    """Return all additional topics of a stream, in the node's order."""
    if header.foreign or header.message_type.is_text:
        return []
    columns = {role: at for at, role in enumerate(header.roles) if role is not None}

    def picked(values: NDArray[Any], roles: Sequence[ChannelRole]) -> Floats:
        return values[:, [columns[role] for role in roles]].astype(np.float64)

    def charge(values: NDArray[Any]) -> NDArray[np.float32]:
        return _battery(picked(values, [ChannelRole.STATE_OF_CHARGE]))

    def motion(values: NDArray[Any]) -> Floats:
        return _imu(picked(values, ORIENTATION), picked(values, ACCELERATION))

    def field(values: NDArray[Any]) -> Floats:
        return _magnetic_field(picked(values, MAGNETIC_FIELD))

    battery_rows = HeadedRows(frame_id, _FLOAT32, 7, _battery_tail(header))
    kinds = (
        (_temperature_topic, "Temperature", _temperature, _doubles(frame_id, 2)),
        (_battery_state_topic, "BatteryState", charge, battery_rows),
        (_imu_topic, "Imu", motion, _doubles(frame_id, 37)),
        (_magnetic_field_topic, "MagneticField", field, _doubles(frame_id, 12)),
    )
    return [
        StandardMessage(data, f"sensor_msgs/msg/{name}", fill, rows)
        for find, name, fill, rows in kinds
        if (data := find(header))
    ]


def _doubles(frame_id: str, columns: int) -> HeadedRows:
    return HeadedRows(frame_id, _FLOAT64, columns)


def _temperature(values: NDArray[Any]) -> Floats:
    """Return temperature and variance."""
    return np.column_stack((values[:, 0].astype(np.float64), np.zeros(len(values))))


def _battery(percent: Floats) -> NDArray[np.float32]:
    rows = np.full((len(percent), 7), math.nan, np.float32)
    with np.errstate(over="ignore"):
        rows[:, 6] = percent[:, 0] / 100
    return rows


def _battery_tail(header: StreamHeader) -> bytes:
    identity = header.identity
    return aligned(_BATTERY + text(identity.label), 4) + text(identity.unit)


def _imu(orientation: Floats, in_g: Floats) -> Floats:
    """Return orientation, angular velocity and acceleration, each with its covariance."""
    w, x, y, z = orientation.T
    rows = np.zeros((len(w), 37))
    is_known = ~np.isnan(x + y + z + w)
    rows[:, 3] = 1.0
    rows[is_known, :4] = np.column_stack((x, y, z, w))[is_known]
    # A first element of -1 in a covariance marks a missing quantity.
    rows[~is_known, 4] = -1.0
    rows[:, 16] = -1.0
    has_acceleration = ~np.isnan(in_g).any(axis=1)
    rows[has_acceleration, 25:28] = STANDARD_GRAVITY * in_g[has_acceleration]
    rows[~has_acceleration, 28] = -1.0
    return rows


def _magnetic_field(microtesla: Floats) -> Floats:
    return np.hstack((_TESLA_PER_MICROTESLA * microtesla, np.zeros((len(microtesla), 9))))


def _temperature_topic(header: StreamHeader) -> str:
    """Return ``<data>_temperature``; empty if the stream is not a temperature."""
    fits = header.content_type == ContentType.TEMPERATURE and header.units == (Unit.CELSIUS,)
    return f"{header.data_name}_temperature" if fits else ""


def _battery_state_topic(header: StreamHeader) -> str:
    """Return ``<data>_state`` for a charge alone, ``bat_state`` among others, else empty."""
    if ChannelRole.STATE_OF_CHARGE not in header.roles:
        return ""
    return f"{header.data_name}_state" if len(header.roles) == 1 else _BATTERY_AMONG_OTHERS


def _imu_topic(header: StreamHeader) -> str:
    """Return ``<data>_imu`` for orientation with acceleration; else empty."""
    has_it = {*ORIENTATION, *ACCELERATION} <= set(header.roles)
    return f"{header.data_name}_imu" if has_it else ""


def _magnetic_field_topic(header: StreamHeader) -> str:
    """Return ``<data>_mag`` for a magnetic field in three axes; else empty."""
    return f"{header.data_name}_mag" if set(MAGNETIC_FIELD) <= set(header.roles) else ""
