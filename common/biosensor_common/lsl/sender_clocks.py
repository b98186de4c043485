"""Measures the clocks of senders, with a separate inlet for each measurement.

Once an inlet of liblsl was asked for its sender's clock, it measures it for the rest of its
life in an additional thread, and each measurement leaks some memory. So the inlets for data
are never asked (docs/liblsl-time-receiver.md).
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from time import monotonic
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import pylsl

# As often as LabRecorder, so that stamps are as good in ROS as in a recording.
PERIOD_S = 5.0
STEP_S = 0.1
# liblsl sends eight probes, 64 ms apart, and waits 128 ms for the answers.
PROBES_S = 0.64
# By then liblsl has tried twice: it starts again every 2 s, unless the user's lsl_api.cfg has
# another TimeUpdateInterval.
LIMIT_S = 3.0


class Sender(Protocol):
    """A stream whose sender's clock is to be measured."""

    @property
    def is_ready(self) -> bool:
        """Whether its clock can be measured now."""
        ...

    @property
    def correction(self) -> float | None:
        """Latest measurement; None before the first one."""
        ...

    def open_clock(self) -> pylsl.StreamInlet:
        """Open an inlet for one measurement.

        Raises
        ------
        RuntimeError
            If liblsl can open none.
        """
        ...

    def take_correction(self, correction: float) -> None:
        """Store a measurement, in seconds to add to the sender's stamps."""
        ...


class Measurement:
    """One measurement, which liblsl makes in a separate thread.

    Parameters
    ----------
    inlet
        Used for this measurement only.
    """

    def __init__(self, inlet: pylsl.StreamInlet) -> None:
        self._lsl = inlet
        self._begun_s = monotonic()
        self._ask()

    @property
    def is_late(self) -> bool:
        """Whether the measurement has failed: it takes too long."""
        return monotonic() - self._begun_s > LIMIT_S

    def result(self) -> float | None:
        """Return the seconds to add to the sender's stamps, None while unknown."""
        return self._ask() if monotonic() - self._begun_s > PROBES_S else None

    def _ask(self) -> float | None:
        # Every error of pylsl is a RuntimeError; the usual one says that it takes longer.
        with suppress(RuntimeError):  # nothing is dropped: a measurement that fails is repeated
            return self._lsl.time_correction(0.0)
        return None  # nothing is dropped: the clock is not known yet


class SenderClocks:
    """Measures the clock of each sender as soon as it is ready, and then periodically.

    Parameters
    ----------
    senders
        Returns the present senders, one per stream; called in a separate thread.
    period_s
        From one measurement of a clock to the next.
    """

    def __init__(self, senders: Callable[[], Iterable[Sender]], period_s: float = PERIOD_S) -> None:
        self._senders = senders
        self._period_s = period_s
        self._due_s: dict[Sender, float] = {}
        self._running: dict[Sender, Measurement] = {}
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True, name="sender clocks")
        self._thread.start()

    def stop(self) -> None:
        """End all measurements."""
        self._stopping.set()
        self._thread.join()
        self._running.clear()

    def _run(self) -> None:
        while not self._stopping.wait(STEP_S):
            self._collect()
            present = [sender for sender in self._senders() if sender.is_ready]
            self._forget_all_but(present)
            self._begin(present)

    def _collect(self) -> None:
        for sender, measurement in list(self._running.items()):
            correction = measurement.result()
            if correction is not None:
                sender.take_correction(correction)
            elif measurement.is_late:
                self._due_s[sender] = 0.0
            else:
                continue  # nothing is dropped: the measurement goes on
            del self._running[sender]

    def _forget_all_but(self, present: list[Sender]) -> None:
        for sender in self._due_s.keys() - present:
            del self._due_s[sender]
            self._running.pop(sender, None)

    def _begin(self, present: list[Sender]) -> None:
        now = monotonic()
        due = [
            sender
            for sender in present
            if sender not in self._running and now >= self._due_s.get(sender, 0.0)
        ]
        # Senders without a measurement come first: their stamped messages are waiting for it.
        new = [sender for sender in due if sender.correction is None]
        known = [sender for sender in due if sender.correction is not None]
        known.sort(key=lambda sender: self._due_s.get(sender, 0.0))
        # Spreads the measurements of streams that were found together.
        at_once = math.ceil(len(present) * STEP_S / self._period_s)
        for sender in new + known[:at_once]:
            self._due_s[sender] = now + self._period_s
            # No file descriptor or thread may be left now; it is tried again later.
            # nothing is dropped: the next time there may be a descriptor or thread
            with suppress(RuntimeError):
                self._running[sender] = Measurement(sender.open_clock())
