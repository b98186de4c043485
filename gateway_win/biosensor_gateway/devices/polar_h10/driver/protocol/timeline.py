"""Places the samples of data frames in time, on the device's clock."""

from __future__ import annotations

from dataclasses import dataclass

from biosensor_common.device_clock import LONGEST_DELAY_S

_NS = 1_000_000_000
RATE_TOLERANCE = 0.1
"""Nominal rates hold to 2 % only; what is lost is lost in whole frames."""
LEARNING_STEPS = 3
"""So many frames in a row that agree on another rate than the device said are right."""


@dataclass(frozen=True, slots=True)
class Placed:
    """A frame's place on the device's clock.

    Attributes
    ----------
    times_ns
        Device clock of each sample, ascending.
    lost
        Samples missing before the frame.
    steps_back
        The device's clock did not advance since the frame before.
    """

    times_ns: list[int]
    lost: int
    steps_back: bool


class FrameTimeline:
    """Frames of one measurement in one layout, followed over restarts and connections.

    A frame is stamped at its last sample. Its samples lie evenly behind the last one
    of the frame before; in the first frame, or after a gap, they are as far apart as
    they were so far, which at first is the nominal distance.

    Parameters
    ----------
    nominal_hz
        Sampling rate that the device was asked for.
    is_doubted
        Firmware is known that sends at another rate than it says: what the first frames seem
        to miss is not counted before they agree on the rate.
    """

    def __init__(self, nominal_hz: float, *, is_doubted: bool = False) -> None:
        self._nominal_hz = nominal_hz
        self._is_doubted = is_doubted
        self._another = _AnotherRate()
        self._nominal_ns = _NS / nominal_hz
        self._measured_ns = 0
        self._measured_samples = 0
        self._previous_ns: int | None = None
        self._last: tuple[int, float] | None = None

    @property
    def rate_hz(self) -> float:
        """Sampling rate by the device's clock, as far as it was measured."""
        return _NS / self._period_ns

    def restart(self, nominal_hz: float) -> None:
        """Begin again, as when the measurement was stopped and started."""
        self._previous_ns = None
        if nominal_hz != self._nominal_hz:
            self._nominal_hz, self._nominal_ns = nominal_hz, _NS / nominal_hz
            self._measured_ns = self._measured_samples = 0

    def place(self, timestamp_ns: int, count: int, arrival_s: float) -> Placed:
        """Place the next frame.

        Parameters
        ----------
        timestamp_ns
            The frame's stamp.
        count
            Its samples, at least one.
        arrival_s
            Host's clock when it arrived, to tell a gap from a clock that was set.
        """
        previous_ns, self._previous_ns = self._previous_ns, timestamp_ns
        steps_back = previous_ns is not None and timestamp_ns <= previous_ns
        span_ns = 0 if previous_ns is None else timestamp_ns - previous_ns
        period_ns = self._period_ns
        difference = span_ns / period_ns - count
        follows = abs(difference) <= 0.5 + RATE_TOLERANCE * count
        if previous_ns is not None and follows:
            self._measured_ns += span_ns
            self._measured_samples += count
            times = [previous_ns + span_ns * (index + 1) // count for index in range(count)]
            lost = self._another.refute() if self._is_doubted else 0
        else:
            times = [timestamp_ns - round(age * period_ns) for age in reversed(range(count))]
            lost = self._missing(timestamp_ns, count, arrival_s)
            if self._may_learn and previous_ns is not None and not steps_back:
                self._learn(span_ns, count, lost)
                lost = 0
        self._last = (timestamp_ns, arrival_s)
        return Placed(times, lost, steps_back)

    @property
    def _period_ns(self) -> float:
        if not self._measured_samples:
            return self._nominal_ns
        return self._measured_ns / self._measured_samples

    @property
    def _may_learn(self) -> bool:
        return self._is_doubted and not self._measured_samples

    def _learn(self, span_ns: int, count: int, lost: int) -> None:
        """Note a frame that does not follow at the nominal rate."""
        if self._another.add(span_ns / count, lost) >= LEARNING_STEPS:
            self._measured_ns, self._measured_samples = span_ns, count
            self._another = _AnotherRate()

    def _missing(self, timestamp_ns: int, count: int, arrival_s: float) -> int:
        if self._last is None:
            return 0
        last_ns, last_arrival_s = self._last
        span_ns = timestamp_ns - last_ns
        if abs(span_ns / _NS - (arrival_s - last_arrival_s)) > LONGEST_DELAY_S:
            return 0
        return max(0, round(span_ns / self._period_ns) - count)


class _AnotherRate:
    """Frames in a row that agree on a rate which is not the nominal one."""

    def __init__(self) -> None:
        self._period_ns = 0.0
        self._steps = 0
        self._lost = 0

    def add(self, period_ns: float, lost: int) -> int:
        """Note the distance of samples; return how many frames agree on it so far."""
        if abs(period_ns - self._period_ns) > RATE_TOLERANCE * abs(self._period_ns):
            self._period_ns, self._steps = period_ns, 0
        self._steps += 1
        self._lost += lost
        return self._steps

    def refute(self) -> int:
        """Return what was lost after all: the nominal rate is right."""
        lost, self._lost, self._steps, self._period_ns = self._lost, 0, 0, 0.0
        return lost
