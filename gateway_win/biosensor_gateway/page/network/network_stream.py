"""One stream of the network: its outlet, its receiver, and its newest samples."""

from __future__ import annotations

import math
from collections import deque
from concurrent.futures import Executor
from dataclasses import dataclass, field
from time import monotonic
from typing import Any

import numpy as np
import pylsl
from numpy.typing import NDArray

from biosensor_common.lsl.header import decoded
from biosensor_common.lsl.inlet import Block, Connection, buffer_length
from biosensor_common.quantities import ChannelFormat
from biosensor_common.stream_header import CoreFields, StreamHeader
from biosensor_gateway.agent.rate_meter import RateMeter

CLOCK_WITHIN_S = 3.0
"""How long samples wait in liblsl for the first measurement of the sender's clock."""
_OPEN_S = 5.0
_BUFFER_S, _BUFFER_SAMPLES = 10, 200_000
_MOST_SAMPLES, _MOST_VALUES = 8192, 1_000_000
_MOST_TEXTS = 16


class Receiver:
    """Receives one stream while a browser shows it.

    Parameters
    ----------
    info
        From a resolver.
    pool
        Opens the inlet; a sender that does not answer blocks the thread for some seconds.
    """

    def __init__(self, info: pylsl.StreamInfo, core: CoreFields, pool: Executor) -> None:
        self._is_text = core.format is ChannelFormat.STRING
        self._most = max(1, min(_MOST_SAMPLES, _MOST_VALUES // core.channel_count))
        self._opened_s = monotonic()
        length = buffer_length(core.rate, _BUFFER_S, _BUFFER_SAMPLES)
        self.connection = Connection(info, pool, _OPEN_S, length, as_numpy=True)

    @property
    def age_s(self) -> float:
        """How long the receiver has been open."""
        return monotonic() - self._opened_s

    @property
    def correction(self) -> float | None:
        """Seconds to add to stamps; None before the sender's clock was measured."""
        return self.connection.correction

    def pull(self) -> Block | None:
        """Return the samples that have arrived, without blocking; None if there are none.

        Raises
        ------
        RuntimeError
            If the stream is lost, or was not opened.
        """
        lsl = self.connection.inlet
        if lsl is None:
            return None  # nothing is dropped: it is being opened
        if self.correction is None and self.age_s < CLOCK_WITHIN_S:
            return None  # nothing is dropped: they wait in liblsl
        # At least one sample is requested, because only a pull detects a lost stream.
        most = _MOST_TEXTS if self._is_text else min(max(1, lsl.samples_available()), self._most)
        samples, stamps = lsl.pull_chunk(0.0, most)
        return Block(samples, stamps) if len(stamps) else None

    def close(self) -> None:
        """Close the inlet; waits for liblsl's threads."""
        self.connection.close()


TEXTS_KEPT = 8
MAX_TEXT = 4000
"""Longer than the text that is shown, because an agent's entries are JSON."""
MAX_COUNTERS = 1_000_000
_TEXT_CHANNELS = 8
_GAP_PERIODS = 1.5
# Other programs often stamp with the time at which they push, so their stamps jitter.
_JITTER_S = 0.1
_MOST_MISSING = 1_000_000_000
LATEST_S, EARLIEST_S = 1.0, 60.0
"""A stamp that is more than this later or earlier than its arrival is another clock's.

Our own streams have no limit for early stamps: a battery level waits for its first receiver.
"""
_DRIFT_S = 2.0

Times = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Entry:
    """One sample of text, with its local LSL time."""

    text: str
    time_s: float


class Received:
    """Counts received samples, and stores the newest.

    Attributes
    ----------
    missing
        Estimated number of missing samples, from the stamps.
    newest_s
        Local LSL time of the newest sample of this inlet; None before the first.
    heard_s
        Local LSL time at which it was received; None before the first.
    values : shape (n_channels,)
        The newest sample; empty for text.
    """

    def __init__(self, core: CoreFields) -> None:
        self.count = self.missing = 0
        # The newest entries of a stream of text, the newest last.
        # nothing is dropped: the page shows the newest only
        self.texts: deque[Entry] = deque(maxlen=TEXTS_KEPT)
        self.begin(core)

    def begin(self, core: CoreFields, *, is_ours: bool = False) -> None:
        """Restart with another inlet; samples in between are unknown."""
        self.newest_s: float | None = None
        self.heard_s: float | None = None
        # nothing is dropped: the page shows the newest only
        self.values: NDArray[np.float64] = np.empty(0)
        self.raw = b""
        self.placer = Placer(is_ours=is_ours)
        self.meter = RateMeter(core.rate)
        self._is_text = core.format is ChannelFormat.STRING
        self._rate = core.rate
        self._last_stamp: float | None = None

    def age_s(self, now: float) -> float | None:
        """Return the age of the newest sample; None if there is none."""
        return None if self.newest_s is None else max(0.0, now - self.newest_s)

    def take(self, block: Block, now: float) -> NDArray[np.float64]:
        """Take samples; return their local LSL times.

        Parameters
        ----------
        now
            Local LSL time.
        """
        times = self.placer.place(block.stamps, now)
        self._find_gaps(block.stamps)
        self.count += len(times)
        self.newest_s, self.heard_s = float(times[-1]), now
        self.meter.note(self.count, self.newest_s)
        if self._is_text:
            rows = zip(block.samples[-TEXTS_KEPT:], times[-TEXTS_KEPT:], strict=True)
            self.texts.extend(Entry(_text(row), float(time)) for row, time in rows)
            self.raw = block.samples[-1][0][: MAX_COUNTERS + 1]
        else:
            self.values = block.samples[-1].astype(np.float64)
        return times

    def _find_gaps(self, stamps: NDArray[np.float64]) -> None:
        finite = stamps[np.isfinite(stamps)]
        if not self._rate or not len(finite):
            return  # nothing is dropped: there is nothing to find
        before, self._last_stamp = self._last_stamp, float(finite[-1])
        with np.errstate(over="ignore"):
            steps = np.diff(finite, prepend=finite[0] if before is None else before)
        longest = max(_GAP_PERIODS / self._rate, _JITTER_S)
        for step in steps[(steps > longest) & np.isfinite(steps)]:
            self.missing += math.floor(min(step * self._rate, _MOST_MISSING) + 0.5) - 1


def _text(row: NDArray[Any]) -> str:
    parts = (decoded(each[: 4 * MAX_TEXT]) for each in row[:_TEXT_CHANNELS])
    return ", ".join(parts)[:MAX_TEXT]


class Placer:
    """Computes the local times of the samples of one stream.

    Parameters
    ----------
    is_ours
        Whether an agent of ours stamps them.

    Stamps are of the sender's LSL clock, and the measured clock offset is added. Without a
    measurement, or if a program stamps with another clock (such as Unix time), the times are
    computed from the earliest arrival.
    """

    def __init__(self, *, is_ours: bool = False) -> None:
        self._earliest_s = np.inf if is_ours else EARLIEST_S
        # Seconds to add to a stamp; None before the first measurement.
        self.correction: float | None = None
        self.is_by_arrival = False  # Whether the newest samples were placed by their arrival.
        self._shift_s: float | None = None
        self._last_s = -np.inf

    def place(self, stamps: Times, now: float) -> Times:
        """Return the local LSL times of samples; they never decrease.

        Parameters
        ----------
        stamps : shape (n,)
            As they were received, with any values; n > 0.
        now
            Local LSL time.
        """
        times = stamps if self.correction is None else stamps + self.correction
        self.is_by_arrival = self.correction is None or not self._is_plausible(times, now)
        if self.is_by_arrival:
            times = self._by_arrival(stamps, now)
        if self._last_s > now + LATEST_S:
            self._last_s = -np.inf
        times = np.maximum.accumulate(np.maximum(times, self._last_s))
        self._last_s = float(times[-1])
        return times

    def _by_arrival(self, stamps: Times, now: float) -> Times:
        newest = float(stamps[-1])
        if not np.isfinite(stamps).all() or abs(newest) > 1e15:
            return np.full(len(stamps), now)
        shift = now - newest
        is_new = self._shift_s is None or not 0 <= shift - self._shift_s < _DRIFT_S
        self._shift_s = shift if is_new else self._shift_s
        assert self._shift_s is not None
        return np.clip(stamps + self._shift_s, now - EARLIEST_S, now + LATEST_S)

    def _is_plausible(self, times: Times, now: float) -> bool:
        # Comparisons with NaN are false.
        return bool((times < now + LATEST_S).all() and (times > now - self._earliest_s).all())


UNSEEN_S = 1.5
"""Time after which a stream that the resolver does not report is gone."""
_DEAF_S = 2.0


def claim_of(core: CoreFields) -> tuple[str, str, str, str]:
    """Return the identity that a stream claims; without a source_id, it includes the computer."""
    return core.source_id, core.name, core.content_type, core.source_id or core.hostname


@dataclass(slots=True, eq=False)
class NetworkStream:
    """A stream, over successive outlets."""

    number: int  # Identifies the stream on the page.
    # info, core, uid: of the newest outlet.
    info: pylsl.StreamInfo
    core: CoreFields
    uid: str
    seen_s: float  # Local LSL time at which a resolver last reported that outlet.
    header: StreamHeader | None = None  # None until it is read for the first time.
    namesake: int = 1  # Its number among live senders that claim to be the same stream, from 1.
    note: str = ""
    has_description: bool = False
    # Local LSL time at which its connection ended; None while it is connected.
    lost_s: float | None = None
    receiver: Receiver | None = None
    received: Received = field(init=False)

    def __post_init__(self) -> None:
        self.received = Received(self.core)

    @property
    def is_ours(self) -> bool:
        """Whether an agent of ours sends it."""
        return self.header is not None and not self.header.foreign

    @property
    def claim(self) -> tuple[str, str, str, str]:
        """See `claim_of`."""
        return claim_of(self.core)

    def continues_as(self, core: CoreFields) -> bool:
        """Whether an outlet with these core fields continues this stream."""
        # Our source_ids are unique. Other programs use one for several streams, or none.
        own = self.core
        if (own.source_id, own.channel_count, own.format) != (
            core.source_id,
            core.channel_count,
            core.format,
        ):
            return False
        if self.is_ours:
            return True
        is_same = (own.name, own.content_type) == (core.name, core.content_type)
        return is_same and bool(core.source_id or own.hostname == core.hostname)

    def is_gone(self, now: float) -> bool:
        """Whether neither the resolver nor an inlet has the stream any more."""
        if self.lost_s is not None:
            return True
        heard_s = self.received.heard_s
        is_heard = self.receiver is not None and heard_s is not None and now - heard_s < _DEAF_S
        return now - self.seen_s > UNSEEN_S and not is_heard

    def follow(self, info: pylsl.StreamInfo, core: CoreFields, now: float) -> Receiver | None:
        """Continue with another outlet; return the previous receiver, which must be closed."""
        self.info, self.core, self.uid, self.seen_s = info, core, info.uid(), now
        self.has_description, self.lost_s = False, None
        before, self.receiver = self.receiver, None
        return before
