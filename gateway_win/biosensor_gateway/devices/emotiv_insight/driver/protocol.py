"""Finds values by label in a list of values, by the columns that Cortex named.

The order and number of columns vary with headset, firmware and version of Cortex;
only the reply to ``subscribe`` tells them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple, cast

from biosensor_gateway.devices.emotiv_insight.driver.messages import (
    Data,
    Fault,
    FaultCode,
    list_of,
    number_of,
)

Column = str | tuple[str, ...]
"""A label; several where one value is itself a list, as the contact qualities of ``dev``."""

_NUMERIC_STREAMS = frozenset({"eeg", "mot", "dev", "eq", "pow", "met"})
_NOT_NUMBERS = (".isActive", "MARKERS")
_MOST = 1 << 53
"""Below it, a whole number is a float without loss."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Columns of one stream of one session."""

    columns: tuple[Column, ...]

    @property
    def labels(self) -> frozenset[str]:
        """All labels, those of nested columns too."""
        return frozenset(self.in_order())

    def in_order(self) -> tuple[str, ...]:
        """Return all labels as their values come; those of a nested column in its place."""
        return tuple(
            label
            for column in self.columns
            for label in ((column,) if isinstance(column, str) else column)
        )


class Sample(NamedTuple):
    """One sample of one stream.

    Attributes
    ----------
    time_s
        Unix time on the clock of the computer that runs Cortex.
    numbers
        By label; NaN where Cortex has no value.
    others
        Texts, switches and lists by label.
    """

    stream: str
    time_s: float
    numbers: Mapping[str, float]
    others: Mapping[str, object] = MappingProxyType({})


class _Reading(NamedTuple):
    """How to read the values of one stream; made once, as samples are many."""

    columns: tuple[Column, ...]
    is_nested: bool
    labels: tuple[tuple[str, bool], ...]
    """Each with whether its value must be a number."""


class _FaultError(Exception):
    def __init__(self, code: FaultCode) -> None:
        super().__init__(code.value)
        self.code = code


def layout(cols: object) -> Layout | None:
    """Read the ``cols`` of a subscription; None if they are no list of labels."""
    columns: list[Column] = []
    for column in list_of(cols):
        if isinstance(column, str):
            columns.append(column)
            continue
        labels = list_of(column)
        if not labels or not all(isinstance(label, str) for label in labels):
            return None
        columns.append(tuple(cast("list[str]", labels)))
    return Layout(tuple(columns)) if columns else None


class Decoder:
    """Decodes the data of the sessions and streams that were subscribed to."""

    def __init__(self) -> None:
        self._readings: dict[str, dict[str, _Reading]] = {}

    def subscribed(self, session: str, layouts: Mapping[str, Layout]) -> None:
        """Take in the layouts of a session's streams."""
        readings = self._readings.setdefault(session, {})
        for stream, columns in layouts.items():
            readings[stream] = _reading(stream, columns)

    def decode(self, data: Data) -> Sample | Fault:
        """Give the values of a message their labels; never raises."""
        readings = self._readings.get(data.session)
        if readings is None:
            return Fault(FaultCode.UNKNOWN_SESSION)
        reading = readings.get(data.stream)
        if reading is None:
            return Fault(FaultCode.UNKNOWN_STREAM)
        try:
            numbers, others = _labelled(reading, data.values)
        except _FaultError as fault:
            return Fault(fault.code)
        return Sample(data.stream, data.time_s, numbers, others)


def _reading(stream: str, columns: Layout) -> _Reading:
    is_numeric = stream in _NUMERIC_STREAMS
    return _Reading(
        columns=columns.columns,
        is_nested=not all(isinstance(column, str) for column in columns.columns),
        labels=tuple(
            (label, is_numeric and not label.endswith(_NOT_NUMBERS)) for label in columns.in_order()
        ),
    )


def _labelled(
    reading: _Reading, values: list[object]
) -> tuple[dict[str, float], dict[str, object]]:
    if len(reading.columns) != len(values):
        raise _FaultError(FaultCode.LENGTH_MISMATCH)
    if reading.is_nested:
        values = list(_flat(reading.columns, values))
    numbers: dict[str, float] = {}
    others: dict[str, object] = {}
    for (label, is_number), value in zip(reading.labels, values, strict=True):
        # Most values are these, and a call for each would take longer than all else here.
        if type(value) is float and -math.inf < value < math.inf:
            numbers[label] = value
        elif type(value) is int and -_MOST < value < _MOST:
            numbers[label] = float(value)
        elif (number := number_of(value)) is not None:
            numbers[label] = number
        elif is_number:
            numbers[label] = _missing(value)
        else:
            others[label] = value
    return numbers, others


def _flat(columns: tuple[Column, ...], values: list[object]) -> Iterable[object]:
    for column, value in zip(columns, values, strict=True):
        if isinstance(column, str):
            yield value
        else:
            yield from _nested(column, value)


def _nested(labels: tuple[str, ...], value: object) -> Iterable[object]:
    if value is None:
        return (None for _ in labels)
    if not isinstance(value, list):
        raise _FaultError(FaultCode.BAD_TYPE)
    values = cast("list[object]", value)
    if len(values) != len(labels):
        raise _FaultError(FaultCode.LENGTH_MISMATCH)
    return values


def _missing(value: object) -> float:
    """Return NaN for a value that Cortex does not have; anything else is no number."""
    if value is None:
        return math.nan
    not_finite = isinstance(value, int | float) and not isinstance(value, bool)
    raise _FaultError(FaultCode.NON_FINITE if not_finite else FaultCode.BAD_TYPE)
