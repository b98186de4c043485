"""Subscribers to many topics, in one process or several."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.processes import BenchError, CpuMeter, Process, Processes
from benchmarks.ros_receiver import Subscription

_PATIENCE_S = 60.0
_LAST_SAMPLES_S = 10.0


class Receivers:
    """Starts the processes.

    Parameters
    ----------
    subscription
        Of all together; each process gets its share of the topics.
    """

    def __init__(self, processes: Processes, subscription: Subscription, workers: int = 1) -> None:
        self._children: list[Process] = []
        self._files: list[Path] = []
        for worker in range(workers):
            file = Path(processes.folder, f"arrived{worker}.npy")
            share = replace(
                subscription, topics=_share(subscription.topics, worker, workers), file=str(file)
            )
            self._files.append(file)
            self._children.append(processes.start(*share.as_arguments()))
        self._meters: list[CpuMeter] = []

    def expect_all(self) -> None:
        """Wait until something came on every topic."""
        for child in self._children:
            child.expect("connected", _PATIENCE_S)

    def start_meters(self) -> None:
        """Measure CPU from now on."""
        self._meters = [CpuMeter(child) for child in self._children]

    def cpu_percent(self) -> float:
        """Return the share of one core that the busiest process took since then."""
        return max(meter.percent() for meter in self._meters)

    def finish(self) -> tuple[NDArray[np.float64], int]:
        """End them; return times of arrival, [topics, count], and how many came repeatedly."""
        repeated = finish(self._children)
        return np.concatenate([np.load(file) for file in self._files]), repeated


def finish(children: Sequence[Process]) -> int:
    """Let receiving processes end when all has arrived, or nothing more can be expected.

    Returns how many samples arrived repeatedly.
    """
    end_s = time.monotonic() + _LAST_SAMPLES_S
    for child in children:
        child.line(max(0.0, end_s - time.monotonic()))
    for child in children:
        child.close()
    repeated = sum(_repeated(child) for child in children)
    for child in children:
        child.wait()
    return repeated


def _repeated(child: Process) -> int:
    said = child.line()
    # It may have become complete in the last moment.
    word, _, count = (child.line() if said == "complete" else said).partition(" ")
    if word != "repeated":
        raise BenchError(f"a receiver said {word!r} at its end")
    return int(count)


def _share(topics: Sequence[str], worker: int, workers: int) -> Sequence[str]:
    return topics[worker * len(topics) // workers : (worker + 1) * len(topics) // workers]
