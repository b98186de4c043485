"""Books of a stream over a run of any length: each sample is forgotten once it is settled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.faults.matching import NEAR_S, Places, match
from tests.faults.recorder import Floats, Recorded, Recorder
from tests.rigs.lab_client import Samples

_NEAR_PERIODS = 3
"""What is sent every few seconds is stamped as it arrives, on a busy machine some seconds late."""


class DrainedRecorder(Recorder):
    """A recorder that hands over what it has."""

    def take(self, source: str) -> Recorded:
        """Return what came since the last call."""
        parts = self._parts[source]
        # Its thread appends meanwhile; a slice is replaced in one step.
        taken = parts[:]
        parts[: len(taken)] = [_nothing_like(taken[0])]
        times, values, arrivals = zip(*taken, strict=True)
        return Recorded(np.concatenate(times), np.concatenate(values), np.concatenate(arrivals))


@dataclass
class TruthLedger:
    """Compares what was received with what the device has sent."""

    received: int = 0  # Samples found in the truth, in its order, each once.
    lost: int = 0  # Samples of the truth between them that were not received.
    settled_s: float = -np.inf  # When the newest of them was measured (LSL clock).

    def settle(self, came: Recorded, truth: Samples) -> None:
        """Find what came in a truth that has at least all that was sent since the last call.

        Raises
        ------
        UnknownSampleError
            If a sample came twice, out of order, or was never sent.
        """
        if not len(came.times):
            return
        new = truth.times > self.settled_s
        truth = Samples(truth.times[new], truth.values[new])
        places = self._places(came, truth)
        # What was sent before the recorder was there is not its loss.
        first = 0 if self.received else int(places[0])
        self.lost += int(places[-1]) + 1 - first - len(places)
        self.received += len(places)
        self.settled_s = float(truth.times[places[-1]])

    def _places(self, came: Recorded, truth: Samples) -> Places:
        """Prefer a place without any gap: values that stay the same fit anywhere near."""
        apart_s = np.abs(truth.times - came.times[0])
        near_s = max(NEAR_S, _NEAR_PERIODS * _period_s(truth))
        near = [0] if self.received else np.flatnonzero(apart_s < near_s).tolist()
        for place in sorted(near, key=lambda each: apart_s[each]):
            if _are_equal(came.values, truth.values[place : place + len(came.values)]):
                return np.arange(place, place + len(came.values))
        return match(came, truth, near_s)

    def overdue(self, truth: Samples, since_s: float) -> int:
        """How many samples were measured after a time, and after all that was received."""
        return int((truth.times > max(self.settled_s, since_s)).sum())


@dataclass
class CounterLedger:
    """Compares what was received with what the agent says that it has pushed."""

    # pushed, last_stamp: what the agent said last.
    pushed: int
    last_stamp: float
    pending: Floats  # Stamps of what came and may be newer.
    difference: int = 0  # Received less pushed, over all settlements.

    def settle(self, came: Recorded, pushed: int, last_stamp: float) -> None:
        """Count what came up to the agent's newest sample; later ones wait for the next call."""
        stamps = np.concatenate([self.pending, came.times])
        is_due = (stamps > self.last_stamp) & (stamps <= last_stamp)
        self.difference += int(is_due.sum()) - (pushed - self.pushed)
        self.pending = stamps[stamps > last_stamp]
        self.pushed, self.last_stamp = pushed, last_stamp


def _are_equal(came: Floats, sent: Floats) -> bool:
    # As precise as an LSL stream of floats.
    return len(came) == len(sent) and np.allclose(
        came.astype(np.float32), sent.astype(np.float32), rtol=2e-6, atol=1e-6, equal_nan=True
    )


def _nothing_like(part: Recorded) -> Recorded:
    return Recorded(part.times[:0], part.values[:0], part.arrivals[:0])


def _period_s(truth: Samples) -> float:
    return float(np.median(np.diff(truth.times))) if len(truth.times) > 1 else 0.0
