"""Finds values by label in a list of values, by the columns that Cortex named.

The order and number of columns vary with headset, firmware and version of Cortex;
only the reply to ``subscribe`` tells them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import cast

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


@dataclass(frozen=True, slots=True)
class Layout:
    """Columns of one stream of one session."""

    columns: tuple[Column, ...]

    @property
    def labels(self) -> frozenset[str]:
        """All labels, those of nested columns too."""
        return frozenset(
            label
            for column in self.columns
            for label in ((column,) if isinstance(column, str) else column)
        )


@dataclass(frozen=True, slots=True)
class Sample:
    """One sample of one stream.

    Attributes
    ----------
    stream
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
    others: Mapping[str, object] = field(default_factory=dict[str, object])


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
        self._layouts: dict[str, dict[str, Layout]] = {}

    def subscribed(self, session: str, layouts: Mapping[str, Layout]) -> None:
        """Take in the layouts of a session's streams."""
        self._layouts.setdefault(session, {}).update(layouts)

    def decode(self, data: Data) -> Sample | Fault:
        """Give the values of a message their labels; never raises."""
        layouts = self._layouts.get(data.session)
        if layouts is None:
            return Fault(FaultCode.UNKNOWN_SESSION)
        if data.stream not in layouts:
            return Fault(FaultCode.UNKNOWN_STREAM)
        numbers: dict[str, float] = {}
        others: dict[str, object] = {}
        try:
            for label, value in _labelled(layouts[data.stream].columns, data.values):
                if data.stream in _NUMERIC_STREAMS and not label.endswith(_NOT_NUMBERS):
                    numbers[label] = _number(value)
                elif (number := number_of(value)) is not None:
                    numbers[label] = number
                else:
                    others[label] = value
        except _FaultError as fault:
            return Fault(fault.code)
        return Sample(data.stream, data.time_s, numbers, others)


def _labelled(columns: tuple[Column, ...], values: list[object]) -> Iterable[tuple[str, object]]:
    if len(columns) != len(values):
        raise _FaultError(FaultCode.LENGTH_MISMATCH)
    for column, value in zip(columns, values, strict=True):
        if isinstance(column, str):
            yield column, value
        else:
            yield from _nested(column, value)


def _nested(labels: tuple[str, ...], value: object) -> Iterable[tuple[str, object]]:
    if value is None:
        return ((label, None) for label in labels)
    if not isinstance(value, list):
        raise _FaultError(FaultCode.BAD_TYPE)
    values = cast("list[object]", value)
    if len(values) != len(labels):
        raise _FaultError(FaultCode.LENGTH_MISMATCH)
    return zip(labels, values, strict=True)


def _number(value: object) -> float:
    if value is None:
        return math.nan
    number = number_of(value)
    if number is None:
        not_finite = isinstance(value, int | float) and not isinstance(value, bool)
        raise _FaultError(FaultCode.NON_FINITE if not_finite else FaultCode.BAD_TYPE)
    return number
