"""Values of characteristics, by tables of their fields; no I/O and no clock.

A value begins with flags that say which fields follow, in an order that never changes. The
layouts are those of the Bluetooth SIG [1]_, its decimal numbers those of IEEE 11073-20601.

.. [1] Bluetooth SIG, GATT Specification Supplement.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

ALWAYS = 0
_INTEGERS = {
    "u8": (1, False),
    "u16": (2, False),
    "s16": (2, True),
    "u24": (3, False),
    "u32": (4, False),
}
_SFLOAT_LIMIT, _FLOAT_LIMIT = 0x7FE, 0x7FFFFE
"""From so large a mantissa on, its negative as well, a decimal number is none."""


class Field(NamedTuple):
    """A field of a characteristic.

    Attributes
    ----------
    name
    kind
        ``u8``, ``u16``, ``s16``, ``u24``, ``u32``, ``sfloat`` or ``float``.
    flag
        Bit of the flags that says that it is there; `ALWAYS`.
    scale
        Physical unit of one count.
    """

    name: str
    kind: str
    flag: int = ALWAYS
    scale: float = 1.0


def sfloat(data: bytes) -> float:
    """Read a decimal number of 16 bits: 4 of exponent, 12 of mantissa; NaN where it is none."""
    return _decimal(int.from_bytes(data, "little"), 12, 4, _SFLOAT_LIMIT)


def long_float(data: bytes) -> float:
    """Read a decimal number of 32 bits: 8 of exponent, 24 of mantissa; NaN where it is none."""
    return _decimal(int.from_bytes(data, "little"), 24, 8, _FLOAT_LIMIT)


def read(data: bytes, flag_bytes: int, fields: tuple[Field, ...]) -> Mapping[str, float] | None:
    """Read a value; None if it is cut short.

    Parameters
    ----------
    data
    flag_bytes
        How many bytes the flags have.
    fields
        In their order; what comes behind the last one is passed over.

    Returns
    -------
    mapping of str to float, or None
        By name, ``flags`` among them; of fields that are not there, nothing.
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
    # Of the largest, each has a meaning of its own: infinity, no number, not at this resolution.
    if abs(mantissa) >= limit:
        return math.nan
    return mantissa / 10**-exponent if exponent < 0 else float(mantissa * 10**exponent)


def _signed(number: int, bits: int) -> int:
    return number - (1 << bits) if number >> (bits - 1) else number
