"""Reads one JSON value a line."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from math import isfinite, nan
from typing import cast

from biosensor_gateway.devices.line_sensor.declaration import Column
from biosensor_gateway.devices.line_sensor.driver.protocol.rows import Flaw, Row, Wrong

_SHOWN = 5
_LONGEST_KEY = 20


class JsonReader:
    """Reads objects by their keys, and arrays by the order of the columns.

    A column's value is that of the key with its label, or of that key inside the object that its
    stream's name is the key of. What is missing or null is no value.

    Parameters
    ----------
    columns
        Of the settings.
    needed
        Positions of those that each line must have.
    """

    def __init__(self, columns: Sequence[Column], needed: Collection[int] = ()) -> None:
        self._columns = tuple(columns)
        self._needed = frozenset(needed)

    def __call__(self, line: str) -> Row | Wrong | None:
        """Read a line."""
        try:
            said: object = json.loads(line)
        except (ValueError, RecursionError):
            hint = "" if line.startswith(("{", "[")) else '; is it format = "csv"?'
            return Wrong(Flaw.NOT_JSON, f"is no JSON{hint}")
        if isinstance(said, dict):
            return self._of_object(cast("dict[str, object]", said))
        if isinstance(said, list):
            return self._of_array(cast("list[object]", said))
        return Wrong(Flaw.NOT_JSON, "is neither a JSON object nor an array")

    def _of_object(self, said: dict[str, object]) -> Row | Wrong:
        values = [_looked_up(said, each) for each in self._columns]
        missing = [
            each.label
            for position, (each, value) in enumerate(zip(self._columns, values, strict=True))
            if value is None and (position in self._needed)
        ]
        if missing or all(value is None for value in values):
            wanted = missing or [each.label for each in self._columns if not each.is_skipped]
            has = ", ".join(ascii(each[:_LONGEST_KEY]) for each in list(said)[:_SHOWN]) or "none"
            names = ", ".join(wanted[:_SHOWN])
            return Wrong(Flaw.NO_KEYS, f"has no key {names}; its keys are {has}")
        return self._row(values)

    def _of_array(self, said: list[object]) -> Row | Wrong:
        if len(said) != len(self._columns):
            wanted = len(self._columns)
            return Wrong(Flaw.COUNT, f"has {len(said)} values, and columns names {wanted}")
        return self._row(said)

    def _row(self, values: Sequence[object]) -> Row | Wrong:
        row: list[float] = []
        for each, value in zip(self._columns, values, strict=True):
            number = nan if each.is_skipped else _number(value)
            if number is None:
                return Wrong(Flaw.NOT_A_NUMBER, f"has no number in {each.label}")
            row.append(number)
        return tuple(row)


def _looked_up(said: dict[str, object], each: Column) -> object:
    inner = said.get(each.stream)
    if isinstance(inner, dict) and each.label in inner:
        return cast("dict[str, object]", inner)[each.label]
    return said.get(each.label)


def _number(value: object) -> float | None:
    if value is None:
        return nan
    if not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return nan
    return number if isfinite(number) else nan
