"""Receives one outlet of a stream, and computes the features of what it sends."""

from __future__ import annotations

import socket
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any, Protocol

import numpy as np
import pylsl

from biosensor_common.lsl.inlets import open_inlet
from biosensor_common.refusal import Refusal
from biosensor_gateway.features.motion import Motions
from biosensor_gateway.features.runs import Event
from biosensor_gateway.features.sources import Source

_OPEN_S = 5.0
_CLOCK_S, _CLOCK_EVERY_S, _CLOCK_AT_MOST_S = 1.0, 5.0, 60.0
"""A computer that hangs is asked the less often the longer it does: others wait for the same
threads."""
_MOST_HELD = 4096
"""Runs of events that wait for the first correction of their stamps."""
_BUFFER_S = 360
_MOST_SAMPLES = 8192


Remark = tuple[Refusal, int, str]
"""What was left out, how much, and why."""


class Clock(Protocol):
    """An inlet, as far as it says what the time is at its sender."""

    def time_correction(self, timeout: float, /) -> float:
        """Return the seconds to add to a stamp; raises TimeoutError after this time."""
        ...


class Correction:
    """What brings the stamps of one stream to the clock of this computer; asked in a thread."""

    def __init__(self, inlet: Clock, asking: Executor) -> None:
        self._inlet, self._asking = inlet, asking
        self._asked: Future[float] | None = None
        self._next_s = 0.0
        self._every_s = _CLOCK_EVERY_S
        self._last_s: float | None = None

    def seconds(self, now_s: float) -> float | None:
        """Return the last one that is known, None before the first; never waits."""
        if self._asked is None and now_s >= self._next_s:
            self._asked = self._asking.submit(self._inlet.time_correction, _CLOCK_S)
            self._next_s = now_s + self._every_s
        if self._asked is not None and self._asked.done():
            # Where there is no answer the last one holds meanwhile: clocks drift slowly.
            if self._asked.exception() is None:
                self._last_s = self._asked.result()
                self._every_s = _CLOCK_EVERY_S
            else:
                self._every_s = min(2 * self._every_s, _CLOCK_AT_MOST_S)
            self._asked = None
        return self._last_s


class Link:
    """One outlet of a source: its inlet, and what computes.

    Parameters
    ----------
    source
        What is computed of it.
    info
        As a resolver gave it.
    asking
        Its threads wait for the sender.
    motions
        Of all devices.

    Attributes
    ----------
    uid
        Of the outlet.
    """

    def __init__(
        self,
        source: Source,
        info: pylsl.StreamInfo,
        asking: ThreadPoolExecutor,
        motions: Motions,
    ) -> None:
        self.uid, self._name = info.uid(), source.name
        self._asking = asking
        self._opening = asking.submit(open_inlet, info, _OPEN_S, _BUFFER_S)
        # On one computer stamps stay as they are, to the last bit.
        self._is_here = info.hostname() == socket.gethostname()
        self._correction: Correction | None = None
        self._computer = source.new_computer(motions)
        self._told = self._gone = self._told_gone = self._told_values = 0
        # nothing is dropped: what is given up is counted in `read` and told by `remarks`
        self._held: deque[Sequence[Event]] = deque(maxlen=_MOST_HELD)

    @property
    def is_open(self) -> bool:
        """Whether it receives."""
        return self._opening.done() and self._opening.exception() is None

    def read(self, now_s: float) -> list[tuple[Sequence[Event], float]]:
        """Take in what has come, without waiting.

        Returns
        -------
        list
            Events of which the time is known by now, each with the seconds to add to its stamps
            for the clock of this computer.

        Raises
        ------
        RuntimeError
            The outlet is gone, or does not answer.
        """
        if not self._opening.done():
            return []  # nothing is dropped: it is being opened
        inlet = self._opening.result()
        pulled: tuple[Any, Any] = inlet.pull_chunk(0.0, _MOST_SAMPLES)
        samples, stamps = pulled
        if stamps:
            events = self._computer.take(
                np.array(stamps, np.float64), np.array(samples, np.float64)
            )
            if events:
                self._gone += len(self._held) == _MOST_HELD
                self._held.append(events)
        seconds = 0.0 if self._is_here else self._seconds(inlet, now_s)
        known: list[tuple[Sequence[Event], float]] = []
        while self._held and seconds is not None:
            known.append((self._held.popleft(), seconds))
        return known

    def remarks(self) -> list[Remark]:
        """Say what was left out since the last call; of stamps when it is twice as much."""
        found: list[Remark] = []
        if self._computer.left_out > self._told:
            new = self._computer.left_out - self._told // 2
            self._told = 2 * self._computer.left_out
            why = self._computer.remark().removeprefix(f"{self._name}: ")
            found.append((Refusal.STAMPS_LEFT_OUT, new, why))
        if new := self._computer.without_value - self._told_values:
            self._told_values += new
            found.append((Refusal.NO_FINITE_VALUE, new, ""))
        if new := self._gone - self._told_gone:
            self._told_gone += new
            found.append((Refusal.UNSTAMPED, new, ""))
        return found

    def close(self) -> None:
        """Close the inlet; one that is being opened closes by itself."""
        if not self._opening.cancel() and self.is_open:
            self._opening.result().close_stream()

    def _seconds(self, inlet: pylsl.StreamInlet, now_s: float) -> float | None:
        self._correction = self._correction or Correction(inlet, self._asking)
        return self._correction.seconds(now_s)
