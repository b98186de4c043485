"""Many streams from as many processes as none of them is the bottleneck."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.lsl_sender import Offer
from benchmarks.processes import CpuMeter, Process, Processes
from benchmarks.samples import RATE_HZ, stream_names

STREAMS_PER_PROCESS = 8
BLOCK, BLOCK_STREAMS_PER_PROCESS = 8, 32
"""Samples sent at once, and by how few processes, where two cores have no room for all the senders
that wake up for each sample."""
_PATIENCE_S = 60.0


@dataclass(frozen=True, slots=True)
class Sent:
    """What the senders did in one round."""

    times: NDArray[np.float64]  # Of sending, shape [streams, count].
    # late_p50_ms, late_p99_ms: how long after its due time a sample was pushed.
    late_p50_ms: float
    late_p99_ms: float
    cpu_percent: float  # Of one core, the busiest process.


class Senders:
    """Starts the processes at once; they send until they have to finish.

    Parameters
    ----------
    rate_hz
        Of each stream.
    per_process
        Streams in one process.
    frugal, block
        See `Offer`.
    """

    def __init__(
        self,
        processes: Processes,
        streams: int,
        rate_hz: float = RATE_HZ,
        per_process: int = STREAMS_PER_PROCESS,
        *,
        frugal: bool = False,
        block: int = 1,
    ) -> None:
        self._block = block
        self._folder = processes.folder
        self.names = stream_names(streams)  # Of the streams.
        self._children: list[Process] = []
        for first in range(0, streams, per_process):
            # The processes take turns: within a stream's share of the period, or all of it.
            share = first / streams if frugal else first / per_process / streams
            names = self.names[first : first + per_process]
            offer = Offer(
                names, rate_hz, offset_s=block * share / rate_hz, frugal=frugal, block=block
            )
            self._children.append(processes.start(*offer.as_arguments()))

    def expect_up(self) -> float:
        """Wait until all outlets are there; return the monotonic time of the last one."""
        return max(float(child.expect("up")[0]) for child in self._children)

    def send(self, seconds: float) -> Sent:
        """Send numbered samples for so long."""
        count = self.count(seconds)
        files = [Path(self._folder, f"sent{i}.npy") for i in range(len(self._children))]
        meters = [CpuMeter(child) for child in self._children]
        for child, file in zip(self._children, files, strict=True):
            child.tell(f"{count // self._block} {file}")
        for child in self._children:
            child.expect("sent", seconds + _PATIENCE_S)
        cpu_percent = max(meter.percent() for meter in meters)
        times = np.concatenate([np.load(file) for file in files], axis=1)
        sent, due = times.repeat(self._block, axis=2)
        late_p50, late_p99 = np.percentile(1e3 * (sent - due), (50, 99))
        return Sent(sent, float(late_p50), float(late_p99), cpu_percent)

    @staticmethod
    def count(seconds: float) -> int:
        """Return how many samples of each stream are sent in so long."""
        return round(seconds * RATE_HZ)

    def finish(self) -> None:
        """End the processes."""
        for child in self._children:
            child.close()
        for child in self._children:
            child.wait()
