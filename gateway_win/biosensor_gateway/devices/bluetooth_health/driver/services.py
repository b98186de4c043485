"""The supported services: a new one needs a row here, and its streams in the declaration."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

Values = Mapping[str, float]
Sampling = Callable[[Values, float], list[float] | None]
"""Creates a sample from fields and their LSL time of arrival; None without a sample."""
Making = Callable[[float], Sampling]
"""Creates a `Sampling` for each connection; takes the circumference of the wheel in m."""
_FAHRENHEIT = 1
_TICKS_PER_S = 1024
# Sensor unconnected to user, displaced, disconnected.
_OFF = 1 << 11 | 1 << 13 | 1 << 15

STANDSTILL_S = 3.0
"""A rotation that takes longer counts as standstill."""
_TIME_TURNS = 1 << 16


class _Event(NamedTuple):
    """A count with the time of its event in ticks, and the LSL time when it was first received."""

    turns: float
    ticks: float
    heard_s: float


class Revolutions:
    """Converts counts of revolutions to rates.

    Parameters
    ----------
    bits
        Width of the count, at which it overflows; 0 for none, as for a wheel, which may turn
        backwards [1]_. The rate is negative then, and also when a device restarts its count.

    .. [1] Bluetooth SIG, Cycling Speed and Cadence Service 1.0, 3.1.1.
    """

    def __init__(self, bits: int) -> None:
        self._modulus = 1 << bits if bits else math.inf
        self._last: _Event | None = None
        self._turned_s = -math.inf

    def rate(self, count: float | None, ticks: float | None, arrival_s: float) -> float:
        """Return revolutions per second since the last event; NaN while unknown.

        Parameters
        ----------
        count, ticks
            As sent by the device; None if missing.
        """
        if count is None or ticks is None:
            return math.nan
        last, now = self._last, _Event(count, ticks, arrival_s)
        if last is None or (count, ticks) != last[:2]:
            self._last = now
        if last is None:
            return math.nan
        turns = count - last.turns
        if not math.isinf(self._modulus):
            turns %= self._modulus
        if not turns:
            return 0.0 if arrival_s - self._turned_s > STANDSTILL_S else math.nan
        self._turned_s = arrival_s
        elapsed_s = self._elapsed_s(last, now)
        if elapsed_s > 0:
            return turns / elapsed_s
        # No bounds accept a negative rate, so that time without progress or back is reported.
        return -abs(turns / elapsed_s) if elapsed_s else -math.inf

    def _elapsed_s(self, last: _Event, now: _Event) -> float:
        """Return the time between two events; arrivals show how often the ticks overflowed."""
        rest_s = (now.ticks - last.ticks) % _TIME_TURNS / _TICKS_PER_S
        period_s = _TIME_TURNS / _TICKS_PER_S
        periods = max(-1, round((now.heard_s - last.heard_s - rest_s) / period_s))
        return rest_s + periods * period_s


# A value begins with flags that show which fields follow, in a fixed order. The layouts are those
# of the Bluetooth SIG's GATT Specification Supplement, with decimal numbers as in IEEE
# 11073-20601.
ALWAYS = 0
_INTEGERS = {
    "u8": (1, False),
    "u16": (2, False),
    "s16": (2, True),
    "u24": (3, False),
    "u32": (4, False),
}
# Mantissas from this absolute value on are special values instead of numbers.
_SFLOAT_LIMIT, _FLOAT_LIMIT = 0x7FE, 0x7FFFFE


class Field(NamedTuple):
    """A field of a characteristic."""

    name: str
    kind: str  # `u8`, `u16`, `s16`, `u24`, `u32`, `sfloat` or `float`.
    flag: int = ALWAYS  # Bit of the flags that shows its presence, or `ALWAYS`.
    scale: float = 1.0  # Size of one count in the physical unit.


def sfloat(data: bytes) -> float:
    """Parse a 16-bit decimal number: 4 bits exponent, 12 bits mantissa; NaN if special."""
    return _decimal(int.from_bytes(data, "little"), 12, 4, _SFLOAT_LIMIT)


def long_float(data: bytes) -> float:
    """Parse a 32-bit decimal number: 8 bits exponent, 24 bits mantissa; NaN if special."""
    return _decimal(int.from_bytes(data, "little"), 24, 8, _FLOAT_LIMIT)


def _read(data: bytes, flag_bytes: int, fields: tuple[Field, ...]) -> Mapping[str, float] | None:
    """Parse a value; None if it is truncated.

    Parameters
    ----------
    fields
        In order; bytes after the last one are ignored.

    Returns
    -------
    mapping of str to float, or None
        Fields by name, including ``flags``, without missing fields.
    """
    if len(data) < flag_bytes:
        return None
    flags = int.from_bytes(data[:flag_bytes], "little")
    found: dict[str, float] = {"flags": flags}
    at = flag_bytes
    for field in fields:
        if field.flag != ALWAYS and not flags & field.flag:
            continue
        size = _size(field.kind)
        if at + size > len(data):
            return None
        found[field.name] = _number(field.kind, data[at : at + size]) * field.scale
        at += size
    return found


def _size(kind: str) -> int:
    return _INTEGERS[kind][0] if kind in _INTEGERS else {"sfloat": 2, "float": 4}[kind]


def _number(kind: str, data: bytes) -> float:
    if kind == "sfloat":
        return sfloat(data)
    if kind == "float":
        return long_float(data)
    return int.from_bytes(data, "little", signed=_INTEGERS[kind][1])


def _decimal(number: int, mantissa_bits: int, exponent_bits: int, limit: int) -> float:
    mantissa = _signed(number & (1 << mantissa_bits) - 1, mantissa_bits)
    exponent = _signed(number >> mantissa_bits, exponent_bits)
    # The largest values have special meanings: infinity, not a number, not at this resolution.
    if abs(mantissa) >= limit:
        return math.nan
    return mantissa / 10**-exponent if exponent < 0 else float(mantissa * 10**exponent)


def _signed(number: int, bits: int) -> int:
    return number - (1 << bits) if number >> (bits - 1) else number


class Row(NamedTuple):
    """A characteristic that a device notifies."""

    title: str
    # service, characteristic: assigned numbers as 128-bit UUIDs.
    service: str
    characteristic: str
    # flag_bytes, fields: layout; see :func:`.layouts.read`.
    flag_bytes: int
    fields: tuple[Field, ...]
    stream: str
    sample: Making  # Creates the function that creates samples.
    # Returns from the fields whether it is worn; None if unknown.
    contact: Callable[[Values], bool | None] | None = None
    due_s: float = 0.0  # Maximum gap while connected; 0 if it is only sent during a measurement.
    # Labels of channels with the field of each that a device may not have.
    optional: tuple[tuple[str, str], ...] = ()

    def parse(self, data: bytes) -> Values | None:
        """Parse a value; None if it is truncated."""
        return _read(data, self.flag_bytes, self.fields)


def _uuid(number: int) -> str:
    return f"0000{number:04x}-0000-1000-8000-00805f9b34fb"


def _plain(*names: str) -> Making:
    """Use fields unchanged as a sample; none if they are missing."""

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
    # Some send 0 where others send that there is no value.
    if not any(found[each] > 0 for each in ("SpO2", "pulse")):
        return False
    return not int(found["device_status"]) & _OFF if "device_status" in found else True


def _turning(wheel_m: float) -> Sampling:
    """Calculate the rates of wheel and crank from counted revolutions."""
    wheel = Revolutions(0)
    crank = Revolutions(16)

    def take(found: Values, arrival_s: float) -> list[float] | None:
        rates = [
            each.rate(found.get(f"{name}_turns"), found.get(f"{name}_time"), arrival_s)
            for name, each in (("wheel", wheel), ("crank", crank))
        ]
        turns_per_s, cadence_hz = rates
        return None if all(map(math.isnan, rates)) else [turns_per_s * wheel_m, cadence_hz * 60]

    return take


SPOT_CHECK = _uuid(0x2A5E)
"""Result of a pulse oximeter's single measurement, sent as an indication; not supported."""

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
        _plain("SpO2", "pulse", "PAI"), _worn, _OFTEN_S, optional=(("PAI", "PAI"),)),
    Row("thermometer", _uuid(0x1809), _uuid(0x2A1C), 1, _THERMOMETER, "temp",
        _thermal),
    Row("foot pod", _uuid(0x1814), _uuid(0x2A53), 1, _FOOT_POD, "running",
        _plain("speed", "cadence")),
    Row("bicycle sensor", _uuid(0x1816), _uuid(0x2A5B), 1, _TURNS, "cycling", _turning,
        optional=(("speed", "wheel_turns"), ("cadence", "crank_turns"))),
    Row("power meter", _uuid(0x1818), _uuid(0x2A63), 2, _POWER, "power", _plain("power")),
)  # fmt: skip
