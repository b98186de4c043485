"""Compares the rate of lines with that of the settings."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan

from biosensor_gateway.devices.line_sensor.driver.protocol import Row
from biosensor_gateway.devices.line_sensor.driver.settings import TICKS_S, LineSettings

WINDOW_S = 5.0
TOLERANCE = 0.1
"""Sketches that wait between their lines are a little slower than they were meant to be."""


class LineRate:
    """Measures how often lines come, by their count and time where they have them.

    Parameters
    ----------
    settings
        With the rate that should be; 0 is none, and nothing is compared.

    Attributes
    ----------
    complaint
        What is wrong with the rate, and what to do; empty if nothing is, or while it is unknown.
    """

    def __init__(self, settings: LineSettings) -> None:
        self._nominal_hz = settings.rate_hz
        self._at_count = settings.position(settings.sequence_column)
        self._at_time = settings.position(settings.time_column)
        self._tick_s = 1.0
        if self._at_time is not None:
            self._tick_s = TICKS_S[settings.parsed_columns[self._at_time].unit]
        self.complaint = ""
        self.begin()

    def begin(self) -> None:
        """Measure again, as from the first line of a connection on."""
        self._first: tuple[float, float] | None = None
        self._lines = 0
        self._wrong_hz = 0.0
        self.complaint = ""

    def take(self, rows: Sequence[Row], arrival_s: float) -> None:
        """Take in rows that came together."""
        if not self._nominal_hz or not rows:
            return  # nothing is dropped: this only looks on
        self._lines += len(rows)
        last = rows[-1]
        count = self._lines if self._at_count is None else last[self._at_count]
        time_s = arrival_s if self._at_time is None else last[self._at_time] * self._tick_s
        if isnan(count) or isnan(time_s):
            return  # nothing is dropped: this only looks on
        first_count, first_s = self._first or (count, time_s)
        if self._first is None or count < first_count or time_s < first_s:
            self._first = count, time_s
        elif time_s - first_s >= WINDOW_S:
            self._judge((count - first_count) / (time_s - first_s))
            self._first = count, time_s

    def _judge(self, hz: float) -> None:
        """Believe a wrong rate at the second time: what waited somewhere comes faster, once."""
        if abs(hz / self._nominal_hz - 1) <= TOLERANCE:
            self._wrong_hz, self.complaint = 0.0, ""
            return
        if self._wrong_hz and abs(hz / self._wrong_hz - 1) <= TOLERANCE:
            self.complaint = (
                f"lines come {hz:.3g} times a second, and the setting `rate_hz` is "
                f"{self._nominal_hz:g}; set `rate_hz = {hz:.3g}`"
            )
        self._wrong_hz = hz
