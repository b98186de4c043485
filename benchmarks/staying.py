"""Whether the node grows while many streams stay."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks import growth
from benchmarks.effort import Effort
from benchmarks.figures import Measurement
from benchmarks.lsl_sender import Offer
from benchmarks.processes import Processes
from benchmarks.samples import stream_names

STREAMS = 64
# Memory does not depend on it, and the machine is free for what runs beside.
_RATE_HZ = 16.0
_PERIOD_S, _PER_GROUP = 2.0, 8
_PATIENCE_S = 60.0


def measure(effort: Effort) -> Measurement:
    """Watch the node; nobody reads.

    Raises
    ------
    BenchError
        If a process failed.
    """
    names = stream_names(STREAMS)
    with tempfile.TemporaryDirectory() as name, Processes(Path(name)) as processes:
        node = processes.start_node()
        source = processes.start(*Offer(names, _RATE_HZ, frugal=True).as_arguments())
        watcher = processes.start("benchmarks.graph_watcher", str(STREAMS))
        source.expect("up")
        watcher.expect("ready")
        watcher.expect("graph", _PATIENCE_S)
        watcher.expect("diagnostics", _PATIENCE_S)
        watcher.wait()
        groups: list[list[growth.State]] = []
        begin_s = time.monotonic()
        while len(groups) < effort.staying_s / _PERIOD_S / _PER_GROUP:
            group: list[growth.State] = []
            for _ in range(_PER_GROUP):
                time.sleep(_PERIOD_S)
                group.append(growth.state(node, time.monotonic() - begin_s))
            groups.append(group)
            sys.stderr.write(f"  {time.monotonic() - begin_s:.0f} of {effort.staying_s:.0f} s\n")
        node.stop()
        source.wait()
    return growth.measurement(f"{STREAMS} streams that stay", groups, _at_rest)


def _at_rest(group: Sequence[growth.State]) -> growth.State:
    """Return the state in which the fewest clocks are being measured."""
    return min(group, key=lambda state: state.threads)
