"""Keeps back what cannot be: values outside the bounds of their declaration, repeated beats."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from biosensor_common.quantities import ContentType, Unit
from biosensor_common.refusal import Refusal
from biosensor_common.refusals import Refusals
from biosensor_common.spec import SensorSpec, StreamSpec
from biosensor_gateway.streaming.counters import Counters
from biosensor_gateway.system.clock import Clock
from biosensor_gateway.system.device_log import DeviceLog, Once

AHEAD_LIMIT_S = 5.0
"""Beats that arrive late have had their time; so far ahead of it are only those told twice."""
MOST_AHEAD_S, MOST_BEHIND_S = 15.0, 60.0
_TOLD_TWICE = (
    "intervals between beats add up to more than the time that has passed, so some are told twice"
)


SHOWN_S = 60.0


class _Checked(NamedTuple):
    """What is left of samples.

    Attributes
    ----------
    samples, times
        To be sent.
    refused
        Of how many samples something was kept back.
    why
        A clause that names the value and what it breaks; empty if nothing is wrong.
    what
        The channel, where it is one.
    """

    samples: ArrayLike
    times: Sequence[float]
    refused: int = 0
    why: str = ""
    what: str = ""


class Plausibility:
    """Checks the samples of one device, and remembers for a person what was not believed."""

    def __init__(self, spec: SensorSpec, clock: Clock, log: DeviceLog) -> None:
        self._clock, self._log = clock, log
        self._is_new = Once()
        self._doubts: dict[str, tuple[float, str, Counters]] = {}
        self._bounds = {
            stream.data_name: _Bounds(stream)
            for stream in spec.streams
            if any(channel.bounds is not None for channel in stream.channels)
        }

    def believed(
        self,
        data_name: str,
        samples: ArrayLike,
        times: Sequence[float],
        counters: Counters,
        refusals: Refusals,
    ) -> tuple[ArrayLike, Sequence[float]]:
        """Return what may be sent; the rest is counted and said, once in the log."""
        bounds = self._bounds.get(data_name)
        if bounds is None:
            return samples, times
        checked = bounds.check(samples, times)
        if checked.why:
            counters.refused += checked.refused
            refusals.refuse(Refusal.IMPLAUSIBLE, checked.refused, why=checked.why)
            self._doubts[data_name] = self._clock(), checked.why, counters
            if self._is_new(data_name, checked.what):
                self._log.warning("values are not sent", data=data_name, cause=checked.why)
        return checked.samples, checked.times

    @property
    def doubt(self) -> str | None:
        """What was not sent in the last minute; None if that is nothing."""
        since_s = self._clock() - SHOWN_S
        parts = [
            f"{name} ({why}; {counters.refused} so far)"
            for name, (time_s, why, counters) in sorted(self._doubts.items())
            if time_s > since_s
        ]
        said = "connected, but it tells what cannot be, which is not sent"
        return f"{said}: {'; '.join(parts)}" if parts else None


class _Bounds:
    """Those of one stream, and how fast its beats may follow each other."""

    def __init__(self, stream: StreamSpec) -> None:
        self._width = len(stream.channels)
        self._stream = stream
        bounds = [channel.bounds or (-np.inf, np.inf) for channel in stream.channels]
        self._low, self._high = np.array(bounds, np.float64).T
        is_intervals = stream.content_type is ContentType.RR
        in_seconds = stream.channels[0].unit == Unit.SECONDS
        self._beats = _Beats() if is_intervals and in_seconds else None

    def check(self, samples: ArrayLike, times: Sequence[float]) -> _Checked:
        """Put NaN in the place of what is outside; leave out samples that have nothing else."""
        checked = _Checked(samples, times)
        values = np.asarray(samples, np.float64)
        # Samples that do not fit their times are refused later on.
        if not len(times) or values.shape[:1] != (len(times),):
            return checked
        if values.size != len(times) * self._width:
            return checked
        rows = values.reshape(len(times), self._width)
        beats = self._beats
        if beats is not None and beats.are_ahead(float(np.nansum(rows[:, 0])), max(times)):
            return _Checked((), (), len(times), _TOLD_TWICE)
        outside = (rows < self._low) | (rows > self._high)
        if not outside.any():
            return checked
        row, column = (int(each) for each in np.argwhere(outside)[-1])
        left = np.where(outside, np.nan, rows)
        is_kept = ~outside.any(axis=1)
        if self._stream.format.is_float:
            # A regular stream keeps its pace.
            is_kept = is_kept | self._stream.is_regular | ~np.isnan(left).all(axis=1)
        times = [time for time, kept in zip(checked.times, is_kept, strict=True) if kept]
        why = self._sentence(column, float(rows[row, column]))
        what = self._stream.channels[column].label
        return _Checked(left[is_kept], times, int(outside.any(axis=1).sum()), why, what)

    def _sentence(self, column: int, value: float) -> str:
        channel = self._stream.channels[column]
        return (
            f"{channel.label} was {value:g} {channel.unit}, which is not between "
            f"{self._low[column]:g} and {self._high[column]:g}"
        )


class _Beats:
    """How far the intervals of a stream are ahead of the time that has passed, by its stamps."""

    def __init__(self) -> None:
        self._ahead_s = 0.0
        self._newest_s: float | None = None

    def are_ahead(self, sum_s: float, newest_s: float) -> bool:
        """Take intervals in; tell whether they are too many for the time that has passed.

        Those that come first may be older. Time that passed without intervals is kept for a
        while, for what was held up.
        """
        before_s = self._newest_s
        if before_s is None:
            self._newest_s = newest_s
            return False
        self._newest_s = max(before_s, newest_s)
        ahead_s = max(self._ahead_s + sum_s - (self._newest_s - before_s), -MOST_BEHIND_S)
        self._ahead_s = min(ahead_s, MOST_AHEAD_S)
        return ahead_s > AHEAD_LIMIT_S
