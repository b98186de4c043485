"""Adds timestamps to the values of lines, and emits them."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field
from enum import Enum, unique
from math import isnan
from typing import TYPE_CHECKING

from biosensor_gateway.devices.line_sensor import streams_of
from biosensor_gateway.devices.line_sensor.driver.protocol import (
    Row,
    checked_format,
    turns_over_at,
)
from biosensor_gateway.devices.line_sensor.driver.settings import TICKS_S, LineSettings
from biosensor_gateway.system.device_log import DeviceLog

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

_TWICE = "they came twice or out of order"
_NO_PLACE = "their count or their time is not a number"
_KEPT_LINES = 1.5
LEAP_S = 10.0
LEAP = 1000
"""A larger jump ahead makes a line doubtful: in seconds, or in lines without a rate."""
# Tolerated factor between the real rate and that in the settings.
_FASTER = 1.5

# A device's count and time both overflow at some number, and restart with the device.
SLACK_S = 90.0
"""Upper limit of delays in transit or while the agent was not running."""
REORDERED = 32
"""Datagrams overtake each other by fewer lines than this."""
REORDERED_S = 1.0
MOST_LOST = 1_000_000
"""Largest loss that is plausible if no rate limits it."""
USUAL_TURN = 2**32


@unique
class Order(Enum):
    """Place of a line relative to the previous ones."""

    NEXT = "next"
    LATE = "late"
    """It was overtaken or is repeated."""
    RESTART = "restart"
    """The device restarted its count."""


@dataclass(frozen=True, slots=True)
class Place:
    """A line's place among the others."""

    order: Order
    value: float  # Number of lines, or seconds, since the first one.
    step: float  # Increase since the previous line.


class Unwrapped:
    """Unwraps a number that grows, overflows, and restarts with its device.

    Parameters
    ----------
    turns_over_at
        0 if it never overflows.
    reordered
        How far a late number may be behind the newest one.
    may_repeat
        Whether consecutive numbers may be equal, as with a coarse clock.
    """

    def __init__(self, turns_over_at: float, reordered: float, *, may_repeat: bool = False) -> None:
        self._turn = turns_over_at
        self._reordered = reordered
        self._may_repeat = may_repeat
        self._last: float | None = None
        self._total = 0.0
        self._is_again = False

    def begin_again(self) -> None:
        """Take the next number as the first one of a restarted device."""
        self._is_again = self._last is not None

    def step_to(self, number: float) -> float:
        """Return the increase since the previous number; 0 for the first."""
        return 0.0 if self._last is None else number - self._last

    def place(self, number: float, most: float) -> Place:
        """Return the place of a number.

        Parameters
        ----------
        number
            The number as sent.
        most
            Largest possible increase since the previous one.
        """
        if self._last is None or self._is_again:
            order = Order.RESTART if self._is_again else Order.NEXT
            self._is_again = False
            return self._take(order, number, 0.0)
        step = number - self._last
        # A number that seems far ahead may be from before the overflow.
        behind = self._turn - step if self._turn and step > self._turn / 2 else -step
        if 0 <= behind <= self._reordered and not (step == 0 and self._may_repeat):
            return Place(Order.LATE, self._total - behind, -behind)
        if step < 0 and self._last < self._turn:
            step += self._turn
        if not 0 <= step <= most:
            return self._take(Order.RESTART, number, 0.0)
        return self._take(Order.NEXT, number, step)

    def _take(self, order: Order, number: float, step: float) -> Place:
        self._last = number
        self._total = 0.0 if order is Order.RESTART else self._total + step
        return Place(order, self._total, step)


@dataclass(slots=True)
class _Batch:
    """Rows that arrived together, with their device times if available."""

    rows: list[Row] = field(default_factory=list[Row])
    device_s: list[float] = field(default_factory=list[float])


class LineEmitter:
    """Emits the data of one device, over all its connections.

    Timestamps are, in order of preference: the device's time; its count divided by the rate; the
    arrival time.

    Parameters
    ----------
    settings, sink
        Settings and sink of the device.
    """

    def __init__(self, settings: LineSettings, sink: DeviceSink) -> None:
        self._sink = sink
        self._log = DeviceLog("biosensor_gateway.line_sensor", sink.identity)
        self._rate_hz = settings.rate_hz
        self._streams = streams_of(settings.parsed_columns, settings.apart)
        self._irregular = set(self._streams) if not settings.rate_hz else set(settings.irregular)
        self._counted = [name for name in self._streams if name not in settings.irregular]
        self._at_count = settings.position(settings.sequence_column)
        self._at_time = settings.position(settings.time_column)
        self._is_stamped = self._at_time is not None or (
            self._at_count is not None and self._rate_hz > 0
        )
        self._overtakes = settings.udp_port is not None
        self._count = Unwrapped(_count_turn(settings), REORDERED if self._overtakes else 0)
        self._tick_s, time_turn = _clock_of(settings)
        self._time = Unwrapped(time_turn, REORDERED_S / self._tick_s, may_repeat=True)
        self._arrival_s: float | None = None
        self._is_first = True
        self._doubted: tuple[Row, float] | None = None

    def connected(self) -> None:
        """Expect the first lines of a new connection."""
        self.ended()
        self._is_first = True

    def take(self, rows: Sequence[Row], arrival_s: float) -> None:
        """Emit rows that arrived together, and count missing ones."""
        batch = _Batch()
        for row in rows:
            if not self._is_placed(row):
                self._sink.left_out(1, _NO_PLACE)
                continue
            doubted, self._doubted = self._doubted, None
            breaks = not self._is_first and not self._goes_on(row, arrival_s)
            if doubted is not None:
                is_believed = breaks and self._follows(row, doubted[0])
                if is_believed:
                    self._place(*doubted, batch)
                else:
                    self._leave_stray(doubted[0])
                breaks = breaks and not is_believed
            if breaks:
                self._doubted = row, arrival_s
                continue  # nothing is dropped: `_doubted` keeps it until the next one tells
            self._place(row, arrival_s, batch)
        self._emit(batch, arrival_s)

    def ended(self) -> None:
        """Emit a doubtful line after which no other line arrived."""
        if self._doubted is not None:
            batch, (row, arrival_s) = _Batch(), self._doubted
            self._doubted = None
            self._place(row, arrival_s, batch)
            self._emit(batch, arrival_s)

    def _goes_on(self, row: Row, arrival_s: float) -> bool:
        """Whether a line's count and time continue from the previous one, or are late."""
        # If not, it may be a stray line, such as a board's greeting; the next line decides.
        gap_s = 0.0 if self._arrival_s is None else max(0.0, arrival_s - self._arrival_s)
        return self._is_next(row, self._count, self._time, gap_s)

    def _follows(self, row: Row, before: Row) -> bool:
        """Whether a line continues from a doubtful one."""
        count, time = copy(self._count), copy(self._time)
        for follower in (count, time):
            follower.begin_again()
        self._placed(count, before, self._at_count, 0.0)
        self._placed(time, before, self._at_time, 0.0)
        # A repeated greeting does not continue a count.
        return row != before and self._is_next(row, count, time, 0.0, (Order.NEXT,))

    def _is_next(
        self,
        row: Row,
        count: Unwrapped,
        time: Unwrapped,
        gap_s: float,
        orders: Sequence[Order] = (Order.NEXT, Order.LATE),
    ) -> bool:
        places = (
            (self._placed(copy(count), row, self._at_count, self._most(gap_s)), self._leap(gap_s)),
            (
                self._placed(copy(time), row, self._at_time, (gap_s + SLACK_S) / self._tick_s),
                (gap_s + LEAP_S) / self._tick_s,
            ),
        )
        return all(
            place is None or (place.order in orders and place.step <= leap)
            for place, leap in places
        )

    def _leap(self, gap_s: float) -> float:
        """Return the largest increase of the count that is not doubtful."""
        return _FASTER * self._rate_hz * (gap_s + LEAP_S) if self._rate_hz else LEAP

    def _leave_stray(self, row: Row) -> None:
        # Its original bytes are no longer known, so its number of values is counted.
        self._sink.dropped_bytes += len(row)
        self._log.warn_once(
            "a line is left out: its count or time fits neither the line before nor the line after"
        )

    def _is_placed(self, row: Row) -> bool:
        """Whether a row's count and time are numbers; in a struct they may be NaN."""
        needed = [each for each in (self._at_count, self._at_time) if each is not None]
        return not any(isnan(row[each]) for each in needed)

    def _place(self, row: Row, arrival_s: float, batch: _Batch) -> None:
        gap_s = 0.0 if self._arrival_s is None else max(0.0, arrival_s - self._arrival_s)
        count = self._placed(self._count, row, self._at_count, self._most(gap_s))
        if count is not None and count.order is Order.LATE:
            self._leave_out()
            self._arrival_s = arrival_s
            return  # nothing is dropped: `_leave_out` counts it
        if count is not None and count.order is Order.RESTART and self._is_behind(row):
            self._time.begin_again()
        elif self._is_first and self._was_off(row, gap_s):
            self._time.begin_again()
            self._count.begin_again()
            count = self._placed(self._count, row, self._at_count, 0.0)
        self._is_first = False
        time = self._placed(self._time, row, self._at_time, (gap_s + SLACK_S) / self._tick_s)
        if time is not None and time.order is Order.LATE and count is None and self._overtakes:
            self._leave_out()
            return  # nothing is dropped: `_leave_out` counts it
        again = [each for each in (count, time) if each is not None and each.order is Order.RESTART]
        if again:
            self._begin_again(batch, arrival_s, is_clock=(time or count) in again)
        elif count is not None and count.step > 1:
            for name in self._counted:
                self._sink.lost(name, round(count.step) - 1)
        self._arrival_s = arrival_s
        batch.rows.append(row)
        batch.device_s.append(self._device_s(count, time))

    def _is_behind(self, row: Row) -> bool:
        return self._at_time is not None and self._time.step_to(row[self._at_time]) < 0

    def _was_off(self, row: Row, gap_s: float) -> bool:
        """Whether the first line of a new connection shows a restart of the device."""
        # In that case its time is shorter than the pause, and it has not stored data meanwhile.
        if self._at_time is None or self._arrival_s is None:
            return False
        step_s = self._time.step_to(row[self._at_time]) * self._tick_s
        is_next = self._rate_hz > 0 and 0 <= step_s < _KEPT_LINES / self._rate_hz
        return 0 <= step_s < gap_s - REORDERED_S / 2 and not is_next

    def _device_s(self, count: Place | None, time: Place | None) -> float:
        if time is not None:
            return time.value * self._tick_s
        return count.value / self._rate_hz if count is not None and self._rate_hz else 0.0

    def _leave_out(self) -> None:
        self._sink.left_out(1, _TWICE)
        self._log.warn_once("lines came twice or out of order; they are left out")

    def _begin_again(self, batch: _Batch, arrival_s: float, *, is_clock: bool) -> None:
        """Emit the lines from before the restart, and reset count and time."""
        # nothing is dropped: `_emit` sends what came before
        self._log.warning(
            "the device's count started again; if it was not restarted, set "
            "sequence_turns_over_at or time_turns_over_at to where it turns over"
        )
        self._emit(batch, arrival_s)
        batch.rows, batch.device_s = [], []
        if is_clock and self._is_stamped:
            self._sink.restart_clock()

    @staticmethod
    def _placed(follower: Unwrapped, row: Row, position: int | None, most: float) -> Place | None:
        return None if position is None else follower.place(row[position], most)

    def _most(self, gap_s: float) -> float:
        """Return the largest possible increase of the count."""
        if not self._rate_hz:
            return MOST_LOST
        return 1 + _FASTER * self._rate_hz * (gap_s + SLACK_S)

    def _emit(self, batch: _Batch, arrival_s: float) -> None:
        if not batch.rows:
            return  # nothing is dropped: there is nothing
        self._sink.heard()
        if self._is_stamped:
            self._sink.observe(max(batch.device_s), arrival_s)
        times = batch.device_s if self._is_stamped else self._by_arrival(batch, arrival_s)
        emit = self._sink.emit if self._is_stamped else self._sink.emit_at
        for name, positions in self._streams.items():
            samples = [[row[each] for each in positions] for row in batch.rows]
            if name not in self._irregular:
                emit(name, samples, times)
                continue  # nothing is dropped: all of it was emitted
            # nothing is dropped: an irregular stream has nothing in that row
            kept = [
                (sample, time)
                for sample, time in zip(samples, times, strict=True)
                if not all(map(isnan, sample))
            ]
            if kept:
                emit(name, [sample for sample, _ in kept], [time for _, time in kept])

    def _by_arrival(self, batch: _Batch, arrival_s: float) -> list[float]:
        """Return times that end with the arrival, spaced by the rate if known."""
        step_s = 1 / self._rate_hz if self._rate_hz else 0.0
        last = len(batch.rows) - 1
        return [arrival_s - (last - number) * step_s for number in range(last + 1)]


def _count_turn(settings: LineSettings) -> int:
    return settings.sequence_turns_over_at or _struct_turn(settings, settings.sequence_column)


def _clock_of(settings: LineSettings) -> tuple[float, int]:
    """Return the length of a tick in seconds, and the tick at which the clock overflows."""
    position = settings.position(settings.time_column)
    if position is None:
        return 1.0, 0
    unit = settings.parsed_columns[position].unit
    turns = unit in ("us", "ms")
    usual = _struct_turn(settings, settings.time_column) if turns else 0
    return TICKS_S[unit], settings.time_turns_over_at or usual


def _struct_turn(settings: LineSettings, label: str) -> int:
    position = settings.position(label)
    if settings.format != "struct" or position is None:
        return USUAL_TURN
    return turns_over_at(checked_format(settings.struct_format), position)
