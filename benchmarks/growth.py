"""Whether the node grows: what is sampled of its process, and the figures of that."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from benchmarks import slope
from benchmarks.figures import Figure, Measurement, Target
from benchmarks.processes import Process

# What fills for some minutes, such as windows of rates and free lists of memory, is full by then.
_WARM_UP_SHARE = 0.5
# Groups whose median stands for the beginning, and for the end.
_ENDS = 3
_CERTAIN, _NO_GROWTH = Target(1.0), Target(0)


@dataclass(frozen=True, slots=True)
class State:
    """A process at one time."""

    time_s: float
    memory_mb: float
    threads: int
    descriptors: int


Compared = Callable[[Sequence[State]], State]


def state(process: Process, time_s: float) -> State:
    """Return how a process is."""
    return State(time_s, process.memory_mb, process.threads, process.descriptors)


def measurement(title: str, groups: Sequence[Sequence[State]], compared: Compared) -> Measurement:
    """Return the figures of a process that was watched.

    Parameters
    ----------
    groups
        What is averaged before a line is fitted: within one, memory may go up and down.
    compared
        Chooses in each group the state whose threads and descriptors are compared.
    """
    counted = groups[max(1, round(_WARM_UP_SHARE * len(groups))) :]
    hours = [np.mean([each.time_s / 3600 for each in group]) for group in counted]
    memory_mb = [float(np.mean([each.memory_mb for each in group])) for group in counted]
    line = slope.fit(hours, memory_mb)
    places = [compared(group) for group in counted]
    interval = f"95 % interval {line.low:.2f} to {line.high:.2f}, {len(counted)} points"
    figures = [
        Figure("memory at the beginning", memory_mb[0], "MB", note="after the warm-up"),
        Figure("memory at the end", memory_mb[-1], "MB"),
        Figure("slope", line.value, "MB/h", note=interval),
        Figure("slope that is certain", line.low, "MB/h", _CERTAIN, "lower end of the interval"),
        _growth("threads", [each.threads for each in places]),
        _growth("file descriptors", [each.descriptors for each in places]),
    ]
    states = [asdict(each) for group in groups for each in group]
    return Measurement(title, figures, {"slope_mb_per_h": asdict(line), "states": states})


def _growth(title: str, counts: Sequence[int]) -> Figure:
    begin, end = statistics.median(counts[:_ENDS]), statistics.median(counts[-_ENDS:])
    return Figure(f"more {title}", end - begin, "", _NO_GROWTH, f"from {begin:g} to {end:g}")
