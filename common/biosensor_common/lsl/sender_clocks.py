"""Measures the clocks of senders, each time by an inlet that lives for that measurement.

An inlet of liblsl that was once asked for its sender's clock measures it for the rest of
its life, in a thread of its own, and keeps some memory of each time. So the inlets that
bring data are never asked (docs/liblsl-time-receiver.md).
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

# As LabRecorder does, so that stamps are as good in ROS as in a recording.
PERIOD_S = 5.0
STEP_S = 0.1
# liblsl sends eight probes, 64 ms apart, and waits 128 ms for the answers.
PROBES_S = 0.64
# By then it has tried twice: it begins again every 2 s, unless the user's lsl_api.cfg has another
# TimeUpdateInterval.
LIMIT_S = 3.0


class Sender(Protocol):
    """A stream whose sender's clock is to be known."""

    @property
    def is_ready(self) -> bool:
        """Whether it is there to be measured."""
        ...

    @property
    def correction(self) -> float | None:
        """What was measured last; None before the first time."""
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
        """Take in a measurement, in seconds to add to the sender's stamps."""
        ...


class Measurement:
    """One measurement, which liblsl makes in a thread of its own.

    Parameters
    ----------
    inlet
        For this measurement alone.
    """

    def __init__(self, inlet: pylsl.StreamInlet) -> None:
        self._lsl = inlet
        self._begun_s = monotonic()
        self._ask()

    @property
    def is_late(self) -> bool:
        """Whether nothing will come of it any more."""
        return monotonic() - self._begun_s > LIMIT_S

    def result(self) -> float | None:
        """Return the seconds to add to the sender's stamps, None while they are not known."""
        return self._ask() if monotonic() - self._begun_s > PROBES_S else None

    def _ask(self) -> float | None:
        # Every error of pylsl is a RuntimeError; the usual one says that it takes longer.
        with suppress(RuntimeError):
            return self._lsl.time_correction(0.0)
        return None


class SenderClocks:
    """Measures the clock of each sender as soon as it is ready, and again and again.

    Parameters
    ----------
    senders
        Returns the present ones, one per stream; called in a thread of its own.
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
        # What has never been measured holds stamped messages back.
        new = [sender for sender in due if sender.correction is None]
        known = [sender for sender in due if sender.correction is not None]
        known.sort(key=lambda sender: self._due_s.get(sender, 0.0))
        # Streams that came at once shall not be measured at once for ever.
        at_once = math.ceil(len(present) * STEP_S / self._period_s)
        for sender in new + known[:at_once]:
            self._due_s[sender] = now + self._period_s
            # There may be no descriptor or thread left; the next time there may be.
            # nothing is dropped: the next time there may be a descriptor or thread
            with suppress(RuntimeError):
                self._running[sender] = Measurement(sender.open_clock())
