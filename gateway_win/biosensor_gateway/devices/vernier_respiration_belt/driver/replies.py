"""Decodes what a belt says of itself and of its channels in the payloads of its replies.

Layouts are those of Vernier's BSD-licensed godirect-js and GDXLib.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

_STATUS = struct.Struct("<BBBBHBBHBB")
_DEVICE_INFO = struct.Struct("<16s16s32sHHBBBBHBBH6sI64s")
_SENSOR_INFO = struct.Struct("<bBIBB60s32sdddIQIII")
_MASK = struct.Struct("<I")

REFUSED = 0x33
"""Status bits: not recognised, ignored, and two internal errors; the others are warnings."""


@dataclass(frozen=True, slots=True)
class Status:
    """State of the belt.

    Attributes
    ----------
    firmware
        Version of the main processor, ``major.minor.build``.
    ble_firmware
        Version of the radio.
    battery_percent
    charger
        0 idle, 1 charging, 2 complete, 3 error.
    """

    firmware: str
    ble_firmware: str
    battery_percent: int
    charger: int


@dataclass(frozen=True, slots=True)
class Identity:
    """What the belt is; texts are as printed on it."""

    order_code: str
    serial_number: str
    name: str
    firmware: str
    description: str


@dataclass(frozen=True, slots=True)
class Channel:
    """What a channel measures.

    Attributes
    ----------
    number
    description
    unit
        As the device writes it; may be empty.
    min_period_us, max_period_us, granularity_us
        Sampling periods that it can have.
    """

    number: int
    description: str
    unit: str
    min_period_us: int
    max_period_us: int
    granularity_us: int


def parse_status(payload: bytes) -> Status | None:
    """Decode the reply to ``GET_STATUS``; None if it is too short."""
    if len(payload) < _STATUS.size:
        return None
    fields = _STATUS.unpack_from(payload)
    _, _, major, minor, build, ble_major, ble_minor, ble_build, battery, charger = fields
    return Status(
        f"{major}.{minor}.{build}", f"{ble_major}.{ble_minor}.{ble_build}", battery, charger
    )


def parse_device_info(payload: bytes) -> Identity | None:
    """Decode the reply to ``DEVICE_INFO``; None if it is too short."""
    if len(payload) < _DEVICE_INFO.size:
        return None
    fields = _DEVICE_INFO.unpack_from(payload)
    order_code, serial, name, description = (_text(fields[at]) for at in (0, 1, 2, -1))
    major, minor, build = fields[7:10]
    return Identity(order_code, serial, name, f"{major}.{minor}.{build}", description)


def parse_mask(payload: bytes) -> int | None:
    """Decode the reply to ``AVAILABLE_CHANNELS``, bit n for channel n; None if too short."""
    return _MASK.unpack_from(payload)[0] if len(payload) >= _MASK.size else None


def parse_channel(payload: bytes) -> Channel | None:
    """Decode the reply to ``SENSOR_INFO``; None if it is too short or there is no such channel."""
    if len(payload) < _SENSOR_INFO.size:
        return None
    fields = _SENSOR_INFO.unpack_from(payload)
    number, sensor_id = fields[0], fields[2]
    if sensor_id == 0:
        return None
    min_period, max_period, _, granularity, _ = fields[10:]
    return Channel(
        number, _text(fields[5]), _text(fields[6]), min_period, max_period, granularity
    )  # fmt: skip


def _text(field: bytes) -> str:
    return field.split(b"\0")[0].decode("utf-8", "replace").strip()
