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

import pylsl

from lsl_to_ros.lsl.inlets import Inlet, InletState

# As LabRecorder does, so that stamps are as good in ROS as in a recording.
PERIOD_S = 5.0
STEP_S = 0.1
# liblsl sends eight probes, 64 ms apart, and waits 128 ms for the answers.
PROBES_S = 0.64
# By then it has tried twice: it begins anew every 2 s, unless the user's lsl_api.cfg has another
# TimeUpdateInterval.
LIMIT_S = 3.0


class Measurement:
    """One measurement, which liblsl makes in a thread of its own.

    Parameters
    ----------
    info
        The stream as a resolver gave it.

    Raises
    ------
    RuntimeError
        If liblsl can open no inlet.
    """

    def __init__(self, info: pylsl.StreamInfo) -> None:
        # It never asks for data, so no more of it than one second has a place.
        self._lsl = pylsl.StreamInlet(info, max_buflen=1, recover=False)
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
    """Measures the clock of each inlet's sender as soon as it is ready, and again and again.

    Parameters
    ----------
    inlets
        Returns the present ones.
    """

    def __init__(self, inlets: Callable[[], Iterable[Inlet]]) -> None:
        self._inlets = inlets
        self._due_s: dict[Inlet, float] = {}
        self._running: dict[Inlet, Measurement] = {}
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
            present = [inlet for inlet in self._inlets() if inlet.state is InletState.READY]
            self._forget_all_but(present)
            self._begin(present)

    def _collect(self) -> None:
        for inlet, measurement in list(self._running.items()):
            correction = measurement.result()
            if correction is not None:
                inlet.take_correction(correction)
            elif measurement.is_late:
                self._due_s[inlet] = 0.0
            else:
                continue
            del self._running[inlet]

    def _forget_all_but(self, present: list[Inlet]) -> None:
        for inlet in self._due_s.keys() - present:
            del self._due_s[inlet]
            self._running.pop(inlet, None)

    def _begin(self, present: list[Inlet]) -> None:
        now = monotonic()
        due = [
            inlet
            for inlet in present
            if inlet not in self._running and now >= self._due_s.get(inlet, 0.0)
        ]
        # What has never been measured holds stamped messages back.
        new = [inlet for inlet in due if inlet.correction is None]
        known = [inlet for inlet in due if inlet.correction is not None]
        known.sort(key=lambda inlet: self._due_s.get(inlet, 0.0))
        # Streams that came at once shall not be measured at once for ever.
        at_once = math.ceil(len(present) * STEP_S / PERIOD_S)
        for inlet in new + known[:at_once]:
            self._due_s[inlet] = now + PERIOD_S
            # There may be no descriptor or thread left; the next time there may be.
            with suppress(RuntimeError):
                self._running[inlet] = Measurement(inlet.info)
