"""Whether the node grows while streams come and go."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from benchmarks import growth
from benchmarks.effort import Effort
from benchmarks.figures import Measurement
from benchmarks.processes import Process, Processes
from benchmarks.ros_receiver import Subscription
from benchmarks.samples import stream_names, topic_of

STREAMS = 4
PERIOD_S = 2.0
ROTATION = 2 * STREAMS
# The newest stream is received by then, and the next step is not near.
_LOOK_AFTER_S = 0.8 * PERIOD_S


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
        subscriptions = (
            Subscription(raw, 0, f"{name}/raw.npy"),
            Subscription(chunks, 0, f"{name}/chunks.npy", chunks=True),
        )
        receivers = [
            processes.start(*subscription.as_arguments()) for subscription in subscriptions
        ]
        outlets = processes.start("benchmarks.churn_outlets", str(STREAMS), str(PERIOD_S))
        states = _watch(node, outlets, effort.rotations)
        for receiver in receivers:
            # Else the node would have been watched without readers.
            receiver.expect("connected")
            receiver.wait()
        node.stop()
        outlets.wait()
    rotations = [states[i : i + ROTATION] for i in range(0, len(states), ROTATION)]
    title = f"{STREAMS} streams, one comes or goes every {PERIOD_S:g} s"
    # In this step all streams run.
    return growth.measurement(title, rotations, lambda rotation: rotation[STREAMS - 1])


def _watch(node: Process, outlets: Process, rotations: int) -> list[growth.State]:
    begin_s = time.monotonic()
    states: list[growth.State] = []
    for step in range(rotations * ROTATION):
        outlets.expect("step")
        time.sleep(_LOOK_AFTER_S)
        states.append(growth.state(node, time.monotonic() - begin_s))
        if step % ROTATION == 0:
            sys.stderr.write(f"  rotation {step // ROTATION + 1} of {rotations}\n")
    return states
