"""A hundred outlets that come up on one host: how long until the node has them all."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from benchmarks.effort import Effort
from benchmarks.figures import Figure, Measurement, Target
from benchmarks.processes import Processes
from benchmarks.senders import Senders

STREAMS = 100
_MAPPED_S = Target(5.0)
_PATIENCE_S = 120.0
# The rate matters little here, so it is that of a slow sensor.
_RATE_HZ = 4.0
_PER_PROCESS = 25


def measure(effort: Effort) -> Measurement:
    """Measure once, with a node that is already running.

    A stream counts as mapped when its topic is in the ROS graph and /diagnostics, which
    comes once a second, has it too: the node says then that it receives the stream.
    """
    sys.stderr.write(f"  {STREAMS} outlets\n")
    with tempfile.TemporaryDirectory() as name, Processes(Path(name)) as processes:
        node = processes.start_node()
        watcher = processes.start("benchmarks.graph_watcher", str(STREAMS))
        watcher.expect("ready")
        time.sleep(effort.settle_s)
        begin_s = time.monotonic()
        senders = Senders(processes, STREAMS, _RATE_HZ, _PER_PROCESS)
        up_s = senders.expect_up()
        graph_s = float(watcher.expect("graph", _PATIENCE_S)[0]) - up_s
        mapped_s = float(watcher.expect("diagnostics", _PATIENCE_S)[0]) - up_s
        offered_s = up_s - begin_s
        memory_mb, threads = node.memory_mb, node.threads
        watcher.wait()
        node.stop()
        senders.finish()
    figures = [
        Figure("in the ROS graph after", graph_s, "s", note=f"all offered in {offered_s:.1f} s"),
        Figure("in /diagnostics too after", mapped_s, "s", _MAPPED_S),
        Figure("memory of lsl_to_ros", memory_mb, "MB", note=f"resident, {threads} threads"),
    ]
    return Measurement(f"{STREAMS} outlets on one host", figures, {"offered_s": offered_s})
