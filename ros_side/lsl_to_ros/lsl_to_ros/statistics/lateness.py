"""Tells what is late because the computer is busy from what is broken, for the live table."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from math import inf
from pathlib import Path

FIRST_SAMPLE_TIMEOUT_S = 30.0
MOST_TIMES = 3
"""So many times as long as asked it waits at most on a busy computer."""
PATIENCE_S, BUSY_PATIENCE_S = 5.0, 30.0
"""From one topic that comes late to the next; an agent that was refused tries again within 30 s."""
BUSY_SHARE = 0.5
"""Of the time in which this process was ready to run, it had to wait for a processor."""
BUSY_LOAD = 3.0
"""Programs that are ready to run, for each processor, where the system does not tell the share."""


@dataclass(slots=True)
class Waiting:
    """What was asked for, and what has come of it.

    Times are of one steady clock, in seconds.

    Attributes
    ----------
    expected
        Topics that have to come.
    started_s
        When it began.
    asked_s
        How long to wait from the first sample on; None for ever.
    is_busy
        Whether other programs have kept the computer busy.
    is_cut_short
        Whether it was ended before it was over.
    """

    expected: Collection[str]
    started_s: float
    asked_s: float | None
    is_busy: bool = False
    is_cut_short: bool = False
    _came_s: dict[str, float] = field(default_factory=dict[str, float])

    def came(self, topic: str, now_s: float) -> None:
        """Take note of the first sample of a topic."""
        self._came_s.setdefault(topic, now_s)

    @property
    def has_begun(self) -> bool:
        """Whether anything has come."""
        return bool(self._came_s)

    def has(self, topic: str) -> bool:
        """Whether a topic has come."""
        return topic in self._came_s

    @property
    def outstanding(self) -> list[str]:
        """The topics that have not come."""
        return [topic for topic in self.expected if topic not in self._came_s]

    @property
    def first_limit_s(self) -> float:
        """How long the first sample of all may take."""
        return FIRST_SAMPLE_TIMEOUT_S * (MOST_TIMES if self.is_busy else 1)

    @property
    def end_s(self) -> float:
        """When there is nothing more to wait for, as far as is known now."""
        if not self._came_s:
            return self.started_s + self.first_limit_s
        if self.asked_s is None:
            return inf
        # Another thread may add to them.
        came_s = list(self._came_s.values())
        first_s, newest_s = min(came_s), max(came_s)
        if not self.outstanding:
            return first_s + self.asked_s
        patience_s = BUSY_PATIENCE_S if self.is_busy else PATIENCE_S
        later_s = min(newest_s + patience_s, first_s + MOST_TIMES * self.asked_s)
        return max(first_s + self.asked_s, later_s)


class ProcessorWait:
    """Measures whether this process has to wait for a processor, since its start."""

    def is_long(self) -> bool:
        """Whether it waits for most of the time in which it could run."""
        share = waiting_share(_schedules())
        if share is None:
            return os.getloadavg()[0] > BUSY_LOAD * (os.cpu_count() or 1)
        return share > BUSY_SHARE


def waiting_share(schedules: Iterable[str]) -> float | None:
    """Return the share of time that threads waited for a processor; None if it is not known.

    Parameters
    ----------
    schedules
        Linux's ``schedstat`` of each thread: nanoseconds that it ran, and that it waited.
    """
    ran = waited = 0
    for schedule in schedules:
        own = schedule.split()
        ran, waited = ran + int(own[0]), waited + int(own[1])
    return waited / (ran + waited) if ran else None


def _schedules() -> Iterable[str]:
    for each in Path("/proc/self/task").glob("*/schedstat"):
        try:
            yield each.read_text(encoding="ascii")
        except OSError:
            # nothing is dropped: the thread has ended
            continue  # nothing is dropped: as above
