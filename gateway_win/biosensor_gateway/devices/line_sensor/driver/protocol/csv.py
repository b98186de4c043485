"""Reads values between separators."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from math import isnan, nan
from types import MappingProxyType

from biosensor_gateway.devices.line_sensor.declaration import SKIPPED
from biosensor_gateway.devices.line_sensor.driver.protocol.rows import Flaw, Row, Wrong

SEPARATORS = MappingProxyType({"comma": ",", "semicolon": ";", "tab": "\t", "space": " "})
"""What stands between values, by the word for it in the settings."""

# Python's own `float` takes underscores, too, and digits of any alphabet.
_NUMBER = re.compile(r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
# As boards print them: Arduino's Print has these three.
_NO_VALUE = frozenset({"", "nan", "inf", "-inf", "+inf", "ovf"})
_SHOWN = 20


class CsvReader:
    """Reads lines of values; an empty one is no value.

    Parameters
    ----------
    labels
        Of the columns.
    separator
        A key of `SEPARATORS`. With any but the comma, numbers may have a decimal comma.
    needed
        Positions of the columns that each line must have a value in.
    """

    def __init__(self, labels: Sequence[str], separator: str, needed: Collection[int] = ()) -> None:
        self._needed = frozenset(needed)
        self._labels = tuple(labels)
        self._separator = separator

    def __call__(self, line: str) -> Row | Wrong | None:
        """Read a line; one that has the columns' labels is a heading and means nothing."""
        values = _split(line, self._separator)
        if len(values) != len(self._labels):
            return Wrong(Flaw.COUNT, self._miscounted(line, len(values)))
        row: list[float] = []
        for position, label in enumerate(self._labels):
            value = _without_label(values[position], label)
            number = 0.0 if label == SKIPPED else self._number(value)
            if number is None or (position in self._needed and isnan(number)):
                if tuple(values) == self._labels:
                    return None
                shown = value[:_SHOWN]
                return Wrong(Flaw.NOT_A_NUMBER, f"has {shown!r} in column {label}, no number")
            row.append(number)
        return tuple(row)

    def _number(self, value: str) -> float | None:
        if self._separator != "comma":
            value = value.replace(",", ".")
        if _NUMBER.fullmatch(value):
            number = float(value)
            return number if abs(number) < float("inf") else nan
        return nan if value.lower() in _NO_VALUE else None

    def _miscounted(self, line: str, count: int) -> str:
        wanted = len(self._labels)
        said = f"has {_values(count)} between {self._separator}s, and columns names {wanted}"
        others = [each for each in SEPARATORS if len(_split(line, each)) == wanted]
        if line.startswith(("{", "[")):
            return f'{said}; it looks like format = "json"'
        if others:
            return f'{said}; it has as many with separator = "{others[0]}"'
        return said


def _split(line: str, separator: str) -> list[str]:
    if separator == "space":
        return line.split()
    return [each.strip() for each in line.split(SEPARATORS[separator])]


def _without_label(value: str, label: str) -> str:
    """Return what is behind the label, as Arduino's plotter has it: ``gsr:512``."""
    told, colon, number = value.partition(":")
    return number.strip() if colon and label in (told.strip(), SKIPPED) else value


def _values(count: int) -> str:
    return "1 value" if count == 1 else f"{count} values"
