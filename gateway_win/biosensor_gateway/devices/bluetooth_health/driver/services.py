"""The services that are read: a new one is a row here, and its streams in the declaration."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from biosensor_gateway.devices.bluetooth_health.driver.layouts import Field, read
from biosensor_gateway.devices.bluetooth_health.driver.revolutions import Revolutions

Values = Mapping[str, float]
Sampling = Callable[[Values, float], list[float] | None]
"""Makes a sample of fields and their LSL time of arrival; None where there is none."""
Making = Callable[[float], Sampling]
"""Begins anew, as for each connection; takes the circumference of the wheel in m."""
_FAHRENHEIT = 1
_TICKS_PER_S = 1024
# Sensor unconnected to user, displaced, disconnected.
_OFF = 1 << 11 | 1 << 13 | 1 << 15


class Row(NamedTuple):
    """A characteristic that a device sends by itself.

    Attributes
    ----------
    title
        What a device with it is.
    service, characteristic
        Assigned numbers, as UUIDs of 128 bits.
    flag_bytes, fields
        Layout; see :func:`.layouts.read`.
    stream
        Data name.
    sample
        Makes what makes the samples.
    contact
        Tells from the fields whether it is worn; None if they do not say.
    due_s
        Longest absence while it is connected; 0 where it comes when somebody measures.
    """

    title: str
    service: str
    characteristic: str
    flag_bytes: int
    fields: tuple[Field, ...]
    stream: str
    sample: Making
    contact: Callable[[Values], bool | None] | None = None
    due_s: float = 0.0

    def parse(self, data: bytes) -> Values | None:
        """Read a value; None if it is cut short."""
        return read(data, self.flag_bytes, self.fields)


def _uuid(number: int) -> str:
    return f"0000{number:04x}-0000-1000-8000-00805f9b34fb"


def _plain(*names: str) -> Making:
    """Take fields as they are; without any there is no sample."""

    def take(found: Values, _: float) -> list[float] | None:
        sample = [found.get(name, math.nan) for name in names]
        return None if all(map(math.isnan, sample)) else sample

    def make(_: float) -> Sampling:
        return take

    return make


def _celsius(found: Values, _: float) -> list[float] | None:
    number = found["temperature"]
    if math.isnan(number):
        return None
    is_fahrenheit = int(found["flags"]) & _FAHRENHEIT
    return [(number - 32) / 1.8 if is_fahrenheit else number]


def _thermal(_: float) -> Sampling:
    return _celsius


def _worn(found: Values) -> bool | None:
    if math.isnan(found["SpO2"]) and math.isnan(found["pulse"]):
        return False
    return not int(found["device_status"]) & _OFF if "device_status" in found else True


def _turning(wheel_m: float) -> Sampling:
    """Follow wheel and crank, whose turns are counted."""
    wheel = Revolutions(0, _TICKS_PER_S)
    crank = Revolutions(16, _TICKS_PER_S)

    def take(found: Values, arrival_s: float) -> list[float] | None:
        rates = [
            each.rate(found.get(f"{name}_turns"), found.get(f"{name}_time"), arrival_s)
            for name, each in (("wheel", wheel), ("crank", crank))
        ]
        turns_per_s, cadence_hz = rates
        return None if all(map(math.isnan, rates)) else [turns_per_s * wheel_m, cadence_hz * 60]

    return take


SPOT_CHECK = _uuid(0x2A5E)
"""Of a pulse oximeter, by indication when a measurement is over; nothing reads it."""

_OXIMETER = (
    Field("SpO2", "sfloat"),
    Field("pulse", "sfloat"),
    *(Field(name, "sfloat", 1) for name in ("fast_SpO2", "fast_pulse")),
    *(Field(name, "sfloat", 2) for name in ("slow_SpO2", "slow_pulse")),
    Field("measurement_status", "u16", 4),
    Field("device_status", "u24", 8),
    Field("PAI", "sfloat", 16),
)
_THERMOMETER = (Field("temperature", "float"),)
_FOOT_POD = (Field("speed", "u16", scale=1 / 256), Field("cadence", "u8"))
_TURNS = (
    Field("wheel_turns", "u32", 1),
    Field("wheel_time", "u16", 1),
    Field("crank_turns", "u16", 2),
    Field("crank_time", "u16", 2),
)
_POWER = (Field("power", "s16"),)
_OFTEN_S = 10.0

ROWS = (
    Row("pulse oximeter", _uuid(0x1822), _uuid(0x2A5F), 1, _OXIMETER, "spo2",
        _plain("SpO2", "pulse", "PAI"), _worn, _OFTEN_S),
    Row("thermometer", _uuid(0x1809), _uuid(0x2A1C), 1, _THERMOMETER, "temp",
        _thermal),
    Row("foot pod", _uuid(0x1814), _uuid(0x2A53), 1, _FOOT_POD, "running",
        _plain("speed", "cadence")),
    Row("bicycle sensor", _uuid(0x1816), _uuid(0x2A5B), 1, _TURNS, "cycling", _turning),
    Row("power meter", _uuid(0x1818), _uuid(0x2A63), 2, _POWER, "power", _plain("power")),
)  # fmt: skip
