"""Whether the node grows while streams come and go."""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from tests.bench import slope
from tests.bench.effort import Effort
from tests.bench.figures import Figure, Measurement, Target
from tests.bench.processes import Process, Processes
from tests.bench.ros_receiver import Wish
from tests.bench.samples import stream_names, topic_of

STREAMS = 4
PERIOD_S = 2.0
ROTATION = 2 * STREAMS
_WARM_UP_SHARE = 0.3
# The newest stream is received by then, and the next step is not near.
_LOOK_AFTER_S = 0.8 * PERIOD_S
# Rotations whose median stands for the beginning, and for the end.
_ENDS = 3
_NO_GROWTH = Target(0)


@dataclass(frozen=True, slots=True)
class State:
    """The node's process, late in a step."""

    time_s: float
    memory_mb: float
    threads: int
    descriptors: int


def measure(effort: Effort) -> Measurement:
    """Watch the node.

    Of the streams, one is read sample by sample, one by chunks, one both ways, one not
    at all.

    Raises
    ------
    BenchError
        If a process failed.
    """
    names = stream_names(STREAMS)
    raw = [topic_of(name) for name in (names[0], names[2])]
    chunks = [f"{topic_of(name)}_chunk" for name in (names[1], names[2])]
    with tempfile.TemporaryDirectory() as name, Processes(Path(name)) as processes:
        node = processes.start_node()
        wishes = Wish(raw, 0, f"{name}/raw.npy"), Wish(chunks, 0, f"{name}/chunks.npy", chunks=True)
        receivers = [processes.start(*wish.as_arguments()) for wish in wishes]
        outlets = processes.start("tests.bench.churn_outlets", str(STREAMS), str(PERIOD_S))
        states = _watch(node, outlets, effort.rotations)
        for receiver in receivers:
            # Else the node would have been watched without readers.
            receiver.expect("connected")
            receiver.wait()
        node.stop()
        outlets.wait()
    return _measurement(states)


def _watch(node: Process, outlets: Process, rotations: int) -> list[State]:
    begin_s = time.monotonic()
    states: list[State] = []
    for step in range(rotations * ROTATION):
        outlets.expect("step")
        time.sleep(_LOOK_AFTER_S)
        time_s = time.monotonic() - begin_s
        states.append(State(time_s, node.memory_mb, node.threads, node.descriptors))
        if step % ROTATION == 0:
            sys.stderr.write(f"  rotation {step // ROTATION + 1} of {rotations}\n")
    return states


def _measurement(states: Sequence[State]) -> Measurement:
    rotations = [states[i : i + ROTATION] for i in range(0, len(states), ROTATION)]
    counted = rotations[max(1, round(_WARM_UP_SHARE * len(rotations))) :]
    # Means of whole rotations: within one, memory goes up and down with the streams.
    hours = [np.mean([state.time_s / 3600 for state in each]) for each in counted]
    memory_mb = [float(np.mean([state.memory_mb for state in each])) for each in counted]
    line = slope.fit(hours, memory_mb)
    # All streams run in this step.
    full = [each[STREAMS - 1] for each in counted]
    interval = f"95 % interval {line.low:.2f} to {line.high:.2f}, {len(counted)} rotations"
    figures = [
        Figure("memory at the beginning", memory_mb[0], "MB", note="after the warm-up"),
        Figure("memory at the end", memory_mb[-1], "MB"),
        Figure("slope", line.value, "MB/h", note=interval),
        Figure("slope that is certain", line.low, "MB/h", _NO_GROWTH, "lower end of the interval"),
        _growth("threads", [state.threads for state in full]),
        _growth("file descriptors", [state.descriptors for state in full]),
    ]
    details = {"slope_mb_per_h": asdict(line), "states": [asdict(state) for state in states]}
    title = f"{STREAMS} streams, one comes or goes every {PERIOD_S:g} s"
    return Measurement(title, figures, details)


def _growth(title: str, counts: Sequence[int]) -> Figure:
    begin, end = statistics.median(counts[:_ENDS]), statistics.median(counts[-_ENDS:])
    return Figure(f"more {title}", end - begin, "", _NO_GROWTH, f"from {begin:g} to {end:g}")
