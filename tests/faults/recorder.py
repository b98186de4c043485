"""An LSL subscriber that keeps everything, with the time at which it came."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import NamedTuple, Self

import numpy as np
import pylsl
from numpy.typing import NDArray

_POLL_S = 0.02
_CHUNK = 4096

Floats = NDArray[np.float64]


class Recorded(NamedTuple):
    """Samples of one stream: stamps, values (n, channels), and when each was pulled."""

    times: Floats
    values: Floats
    arrivals: Floats

    def since(self, begin_s: float) -> Recorded:
        """Leave out what is stamped before."""
        kept = self.times >= begin_s
        return Recorded(self.times[kept], self.values[kept], self.arrivals[kept])

    def until(self, end_s: float) -> Recorded:
        """Leave out what is stamped later."""
        kept = self.times < end_s
        return Recorded(self.times[kept], self.values[kept], self.arrivals[kept])


class Recorder:
    """Pulls numeric streams in a thread; a context manager.

    Parameters
    ----------
    channels
        Number of channels by source_id.
    """

    def __init__(self, channels: Mapping[str, int]) -> None:
        self._parts = {source: [_nothing(count)] for source, count in channels.items()}
        self._inlets: dict[str, tuple[str, pylsl.StreamInlet]] = {}
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        self._thread.join()
        self._inlets.clear()

    def recorded(self, source: str) -> Recorded:
        """What came so far."""
        times, values, arrivals = zip(*list(self._parts[source]), strict=True)
        return Recorded(np.concatenate(times), np.concatenate(values), np.concatenate(arrivals))

    def newest(self, source: str) -> float:
        """Stamp of the last sample, 0 before the first."""
        times = self._parts[source][-1].times
        return float(times[-1]) if len(times) else 0.0

    def _run(self) -> None:
        resolver = pylsl.ContinuousResolver()
        while not self._stopping.wait(_POLL_S):
            for info in resolver.results():
                self._attach(info)
            for source, (_, inlet) in list(self._inlets.items()):
                self._pull(source, inlet)

    def _attach(self, info: pylsl.StreamInfo) -> None:
        source, uid = info.source_id(), info.uid()
        known = self._inlets.get(source)
        if source in self._parts and (known is None or known[0] != uid):
            self._inlets[source] = uid, pylsl.StreamInlet(info, recover=False)

    def _pull(self, source: str, inlet: pylsl.StreamInlet) -> None:
        samples, stamps = inlet.pull_chunk(timeout=0.0, max_samples=_CHUNK)
        if stamps:
            arrivals = np.full(len(stamps), pylsl.local_clock())
            values = np.array(samples, np.float64).reshape(len(stamps), -1)
            self._parts[source].append(Recorded(np.array(stamps), values, arrivals))


def _nothing(channels: int) -> Recorded:
    return Recorded(np.empty(0), np.empty((0, channels)), np.empty(0))
