"""Measures a stream's rate, silences and losses over the last seconds, and the node's load."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from time import monotonic
from typing import NamedTuple

from biosensor_common.stream_header import stale_after_s

Clock = Callable[[], float]

# Starting up, and finding many streams at once, takes a whole core for some seconds.
SHARE_WINDOW_S = 10.0
# From a whole core on, data wait for the GIL.
BUSY_SHARE, CALM_SHARE = 0.8, 0.65
# Pacing delays a burst by at most half a second, and the backlog after a network cut is gone within
# 2 s. A longer delay in each of so many reports is too much.
LONG_AGE_S, SHORT_AGE_S = 1.0, 0.5
REPORTS = 5
MOST_MARKS = 600


@dataclass(slots=True)
class Hysteresis:
    """A state derived from a value, which does not flip at small changes of it."""

    # begins, ends: the state is on from *begins* on, until the value is below *ends*.
    begins: float
    ends: float
    is_on: bool = False

    def judge(self, value: float, floor: float | None = None) -> bool:
        """Update the state; *floor*, if given, is compared with *begins* instead of *value*."""
        begins = value if floor is None else floor
        self.is_on = value >= self.ends if self.is_on else begins >= self.begins
        return self.is_on


class Backlog:
    """Age of the oldest waiting sample, computed from counts alone.

    Stamps cannot be used, because they include the delay of the device. The resolution is the
    period of the calls, of which the last 600 are remembered.
    """

    def __init__(self) -> None:
        # nothing is dropped: a memory of the node's own load
        self._marks: deque[tuple[float, int]] = deque(maxlen=MOST_MARKS)

    def age(self, now_s: float, gone: int, waiting: int) -> float:
        """Add the counts of delivered and waiting samples; return seconds, 0 if none waits."""
        marks = self._marks
        while marks and marks[0][1] <= gone:
            marks.popleft()
        if not waiting:
            return 0.0
        if not marks or gone + waiting > marks[-1][1]:
            marks.append((now_s, gone + waiting))
        return now_s - marks[0][0]


@dataclass(frozen=True, slots=True)
class LoadFacts:
    """The node's load at one time."""

    share: float | None  # Share of one core used by all threads over the last 10 s; None before.
    age_s: float  # Longest time that data have waited in the node since the previous report.
    # is_busy, is_late: whether share or age is too high, with hysteresis.
    is_busy: bool
    is_late: bool


@dataclass(slots=True)
class Load:
    """Tracks the load of this process from one report to the next."""

    clock: Clock = monotonic
    cpu_clock: Clock = time.process_time
    _points: deque[tuple[float, float]] = field(default_factory=deque[tuple[float, float]])
    _ages: deque[float] = field(default_factory=lambda: deque[float](maxlen=REPORTS))
    _busy: Hysteresis = field(default_factory=lambda: Hysteresis(BUSY_SHARE, CALM_SHARE))
    _late: Hysteresis = field(default_factory=lambda: Hysteresis(LONG_AGE_S, SHORT_AGE_S))
    _oldest_s: float = 0.0

    def waited(self, age_s: float) -> None:
        """Record the present age of waiting data."""
        self._oldest_s = max(self._oldest_s, age_s)

    def look(self) -> LoadFacts:
        """Return the load since the previous call; call it once a second."""
        age_s, self._oldest_s = self._oldest_s, 0.0
        self._ages.append(age_s)
        share = self._share()
        all_late = min(self._ages) if len(self._ages) == REPORTS else 0.0
        return LoadFacts(
            share=share,
            age_s=age_s,
            is_busy=self._busy.judge(share or 0.0),
            is_late=self._late.judge(max(self._ages), floor=all_late),
        )

    def _share(self) -> float | None:
        now, points = self.clock(), self._points
        points.append((now, self.cpu_clock()))
        # The last point that is old enough stays, so that the whole window is covered.
        while len(points) > 1 and now - points[1][0] >= SHARE_WINDOW_S:
            points.popleft()
        begun, used = points[0]
        if now - begun < SHARE_WINDOW_S:
            return None  # nothing is dropped: a share of the processor is unknown
        return (points[-1][1] - used) / (now - begun)


RATE_WINDOW_S = 10.0


class RateMeter:
    """Mean rate over the last seconds, from a growing count.

    Samples come in packets, so the newest sample's time is used, not the time of the
    call: at 250 Hz in packets of 63 the difference is 2 percent.
    """

    def __init__(self) -> None:
        self._points: deque[_Point] = deque()

    def rate(self, count: int, newest_s: float, nominal_hz: float = 0.0) -> float:
        """Add the present count and the newest sample's time; return samples per second.

        It is 0 once the stream is stale, of which several periods of a slow stream are no sign.
        """
        now, stale_s = monotonic(), stale_after_s(nominal_hz)
        if newest_s and (not self._points or count != self._points[-1].samples):
            self._points.append(_Point(now, count, newest_s))
        while self._points and now - self._points[0].seen_s > max(RATE_WINDOW_S, 2 * stale_s):
            self._points.popleft()
        if len(self._points) < 2 or now - self._points[-1].seen_s > stale_s:
            return 0.0
        first, last = self._points[0], self._points[-1]
        elapsed = last.newest_s - first.newest_s
        return (last.samples - first.samples) / elapsed if elapsed > 0 else 0.0


class _Point(NamedTuple):
    seen_s: float
    samples: int
    newest_s: float


# Messages of one topic per second. A subscriber in Python with a core to itself receives
# 4000 to 6000; of 10 000 it lost a third, of 4000 a hundredth.
FAST_HZ, USUAL_HZ = 4000.0, 3000.0


class PublishingRate:
    """Tracks the published messages of one topic over the last 10 s."""

    def __init__(self) -> None:
        self.rate = 0.0
        self._points: deque[tuple[float, int, int]] = deque()
        self._fast = Hysteresis(FAST_HZ, USUAL_HZ)

    @property
    def is_fast(self) -> bool:
        """Whether it is published faster than a usual subscriber receives it."""
        return self._fast.is_on

    def look(self, published: int, not_taken: int) -> int:
        """Add a topic's counts; return by how much the second one grew in the last 10 s.

        The rate is in messages per second, 0 for the first 10 s of a topic.
        """
        now, points = monotonic(), self._points
        if points and published < points[-1][1]:
            # Smaller counts belong to another topic: the stream was renamed.
            points.clear()
        points.append((now, published, not_taken))
        while len(points) > 1 and now - points[1][0] >= RATE_WINDOW_S:
            points.popleft()
        begun, first, untaken = points[0]
        elapsed = now - begun
        self.rate = (published - first) / elapsed if elapsed >= RATE_WINDOW_S else 0.0
        self._fast.judge(self.rate)
        return not_taken - untaken


@dataclass(slots=True)
class StreamStatus:
    """State of one stream's reports from one to the next."""

    meter: RateMeter = field(default_factory=RateMeter)
    begun_s: float = field(default_factory=monotonic)
    troubles: deque[tuple[float, int, int]] = field(default_factory=deque[tuple[float, int, int]])
    received: int = 0
    heard_s: float = field(default_factory=monotonic)
    backlog: Backlog = field(default_factory=Backlog)
    publishing: PublishingRate = field(default_factory=PublishingRate)
    oldest_s: float = 0.0

    def waited(self, age_s: float) -> None:
        """Record the present age of waiting data."""
        self.oldest_s = max(self.oldest_s, age_s)

    def take_oldest(self) -> float:
        """Return the largest recorded age since the last call, in seconds."""
        oldest_s, self.oldest_s = self.oldest_s, 0.0
        return oldest_s

    def silence(self, received: int) -> float:
        """Add the count of samples; return for how many seconds it has not changed."""
        now = monotonic()
        if received != self.received:
            self.received, self.heard_s = received, now
        return now - self.heard_s

    def recent(self, lost: int, unfit: int) -> tuple[int, int]:
        """Add the present counts; return how much they grew in the last 10 s."""
        now = monotonic()
        self.troubles.append((now, lost, unfit))
        while now - self.troubles[0][0] > RATE_WINDOW_S:
            self.troubles.popleft()
        return lost - self.troubles[0][1], unfit - self.troubles[0][2]
