"""Counts lost samples of a stream by comparing with the agent's own count.

The agent says once a second how many samples of each stream it has pushed, up
to which stamp, and how many it lost before. Compared with what was pulled up
to that stamp, the difference is what LSL did not deliver. The comparison waits
until the stream has passed the stamp: both come over connections of their own,
and samples that were pushed together may have one stamp.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

_RECENT = 2048
_WAITING = 16


class _Report(NamedTuple):
    pushed: int
    lost: int
    last_stamp: float


@dataclass(frozen=True, slots=True)
class Losses:
    """Samples missing from one stream.

    Attributes
    ----------
    device
        Lost between sensor and agent; from the start of the agent that was there first.
    transport
        Lost between agent and this node since it first attached.
    """

    device: int
    transport: int

    @property
    def total(self) -> int:
        """Both together."""
        return self.device + self.transport


class CountersComparison:
    """Compares one stream's pulled samples with the agent's counters.

    Its two callers are two threads: the stream's reader and the counters' reader.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._pulled = 0
        # nothing is dropped: a memory of stamps; all are counted
        self._recent: deque[float] = deque(maxlen=_RECENT)
        self._base: int | None = None
        self._before: int | None = None
        self._at_least_before = 0
        # nothing is dropped: a later report has all counts of an earlier one
        self._waiting: deque[_Report] = deque(maxlen=_WAITING)
        self._device = self._transport = 0
        # What was lost of outlets that have ended.
        self._earlier = Losses(device=0, transport=0)
        self._is_known = False

    @property
    def losses(self) -> Losses | None:
        """The latest result, None as long as the agent has said nothing."""
        if not self._is_known:
            return None
        earlier = self._earlier
        return Losses(earlier.device + self._device, earlier.transport + self._transport)

    @property
    def before(self) -> int | None:
        """Samples that the outlet had sent before this node first attached, None while unknown.

        They are not lost: nobody was there. After a node that was there before, they tell
        how many came between the two.
        """
        return self._before

    def pulled(self, stamps: Sequence[float]) -> None:
        """Count samples; the stamps are the sender's, as the agent's report has them."""
        with self._lock:
            self._pulled += len(stamps)
            self._recent.extend(stamps)
            if self._waiting:
                self._settle()

    def reported(self, pushed: int, lost: int, last_stamp: float) -> None:
        """Take in what the agent said of this stream."""
        with self._lock:
            if not pushed:
                self._take_device(lost)
                return  # nothing is dropped: nothing was pushed yet
            self._waiting.append(_Report(pushed, lost, last_stamp))
            self._settle()

    def restarted(self, undelivered: int = 0) -> None:
        """Start anew: the stream comes from an outlet that counts from zero.

        Parameters
        ----------
        undelivered
            Samples that the node had received of the outlet before, and LSL dropped
            when it ended.
        """
        with self._lock:
            self._waiting.clear()
            self._recent.clear()
            # What the new outlet sends before it is attached is lost: the node was there.
            self._pulled, self._base = 0, 0
            transport = self._earlier.transport + self._transport + undelivered
            self._earlier = Losses(self._earlier.device, transport)
            self._transport = 0

    def _take_device(self, lost: int) -> None:
        """Take in the agent's own count; one that falls is that of an agent that started anew."""
        if lost < self._device:
            self._earlier = Losses(self._earlier.device + self._device, self._earlier.transport)
        self._device = lost
        self._is_known = True

    def _settle(self) -> None:
        """Compare the reports whose stamp the stream has passed."""
        while self._waiting and self._recent and self._waiting[0].last_stamp <= self._recent[-1]:
            report = self._waiting[0]
            later = self._pulled_after(report.last_stamp)
            missing = report.pushed - (self._pulled - later)
            if not later and not self._is_complete(missing):
                return  # nothing is dropped: it waits for the samples of this report
            self._waiting.popleft()
            if later == _RECENT:
                continue  # nothing is dropped: a later report tells the same
            if self._base is None and later == self._pulled:
                # Reports may come before the stream is attached: what was pushed between
                # this one and the first sample is in no count yet.
                self._at_least_before = report.pushed
                continue  # nothing is dropped: a later report tells the same
            if self._base is None:
                self._base = self._before = missing
            self._transport = missing - self._base
            self._take_device(report.lost)

    def _is_complete(self, missing: int) -> bool:
        """Whether no more samples of the newest stamp can be on their way."""
        if self._base is None:
            return missing <= self._at_least_before
        if not self._is_known:
            return False
        return missing - self._base <= self._transport

    def _pulled_after(self, stamp: float) -> int:
        count = 0
        for recent in reversed(self._recent):
            if recent <= stamp:
                break
            count += 1
        return count
