"""Receives one outlet of a stream, and computes its features."""

from __future__ import annotations

import socket
from collections import deque
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pylsl

from biosensor_common.lsl.inlet import Connection, buffer_length
from biosensor_common.refusal import Refusal
from biosensor_gateway.features.runs import Event
from biosensor_gateway.features.sources import Source
from biosensor_gateway.features.witnesses import Witnesses

_OPEN_S = 5.0
_MOST_HELD = 4096
"""Number of event lists that may wait for the first clock correction."""
_BUFFER_S = 360
_MOST_SAMPLES = 8192


Remark = tuple[Refusal, int, str]
"""What was left out, how many samples, and why."""


class Link:
    """The inlet of one outlet of a source, and the computation of its features.

    Parameters
    ----------
    source
        The stream and its features.
    info
        Of the outlet, from a resolver.
    asking
        Threads that wait for the sender.
    witnesses
        Of all devices.

    Attributes
    ----------
    uid
        Of the outlet.
    is_here
        Whether the sender is this computer, whose stamps need no clock correction.
    has_received
        Whether a sample has come.
    """

    def __init__(
        self,
        source: Source,
        info: pylsl.StreamInfo,
        asking: ThreadPoolExecutor,
        witnesses: Witnesses,
    ) -> None:
        self.uid, self._name = info.uid(), source.name
        length = buffer_length(source.header.rate, _BUFFER_S)
        self.connection = Connection(info, asking, _OPEN_S, length)
        self.is_here = info.hostname() == socket.gethostname()
        self.has_received = False
        self._computer = source.new_computer(witnesses)
        self._told = self._gone = self._told_gone = self._told_values = 0
        # nothing is dropped: what is given up is counted in `read` and told by `remarks`
        self._held: deque[Sequence[Event]] = deque(maxlen=_MOST_HELD)

    def read(self) -> list[tuple[Sequence[Event], float]]:
        """Receive the samples that have arrived, without blocking.

        Returns
        -------
        list
            Events whose time is known, each with the clock correction to add to its stamps, in
            seconds.

        Raises
        ------
        RuntimeError
            If the outlet has ended, or does not answer.
        """
        inlet = self.connection.inlet
        if inlet is None:
            return []  # nothing is dropped: it is being opened
        pulled: tuple[Any, Any] = inlet.pull_chunk(0.0, _MOST_SAMPLES)
        samples, stamps = pulled
        if stamps:
            self.has_received = True
            events = self._computer.take(
                np.array(stamps, np.float64), np.array(samples, np.float64)
            )
            if events:
                self._gone += len(self._held) == _MOST_HELD
                self._held.append(events)
        # Without an answer, the last correction is still good: clocks drift slowly.
        seconds = 0.0 if self.is_here else self.connection.correction
        known: list[tuple[Sequence[Event], float]] = []
        while self._held and seconds is not None:
            known.append((self._held.popleft(), seconds))
        return known

    def remarks(self) -> list[Remark]:
        """Return what was left out since the last call; wrong stamps when their count doubles."""
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
