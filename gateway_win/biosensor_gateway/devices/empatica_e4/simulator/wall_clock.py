"""The clock of the server's PC, and how it stamps samples."""

from __future__ import annotations

import time
from collections import Counter

from biosensor_gateway.devices.empatica_e4.simulator.wire import Sample
from biosensor_gateway.system.clock import Clock


class WallClock:
    """Unix time on the server's PC.

    Parameters
    ----------
    lsl
        The true time, on the LSL clock.
    """

    def __init__(self, lsl: Clock) -> None:
        self.lsl = lsl
        self._ahead_s = time.time() - lsl()

    def at(self, lsl_s: float) -> float:
        """Return the unix time at an LSL time."""
        return lsl_s + self._ahead_s

    def jump(self, seconds: float) -> None:
        """Set the clock forward or back."""
        self._ahead_s += seconds


class Stamps:
    """Stamps of one radio link.

    The first packet's arrival, plus a sample's number by the nominal rate. Samples
    that do not arrive have no number, so what follows them is stamped too early.
    """

    def __init__(self, clock: WallClock) -> None:
        self._clock = clock
        self._reference_s: float | None = None
        self._numbers: Counter[str] = Counter()

    def stamp(self, sample: Sample, arrives_s: float) -> float:
        """Return the stamp of a sample that arrives now; each may be asked once."""
        if self._reference_s is None:
            self._reference_s = self._clock.at(arrives_s)
        rate_hz = sample.stream.rate_hz
        if rate_hz is None:
            return self._reference_s + sample.after_s
        number = self._numbers[sample.stream.word]
        self._numbers[sample.stream.word] += 1
        return self._reference_s + number / rate_hz

    def jump(self, seconds: float) -> None:
        """Move the reference with the clock."""
        if self._reference_s is not None:
            self._reference_s += seconds
