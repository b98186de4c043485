"""One large chunk: what it costs the node to publish it."""

from __future__ import annotations

import json
import statistics
import sys
import tempfile
from pathlib import Path

from benchmarks.chunk_publisher import SAMPLES
from benchmarks.effort import Effort
from benchmarks.figures import Figure, Measurement, Target
from benchmarks.processes import Processes
from benchmarks.receivers import Receivers
from benchmarks.ros_receiver import Subscription
from benchmarks.samples import CHANNELS

_TOPICS = ("/bench_chunk", "/bench_chunk_floor")
_MEDIAN_US = Target(100.0)
_PATIENCE_S = 60.0


def measure(effort: Effort) -> Measurement:
    """Publish with one subscriber in another process."""
    sys.stderr.write(f"  {effort.published} chunks\n")
    with tempfile.TemporaryDirectory() as name, Processes(Path(name)) as processes:
        publisher = processes.start("benchmarks.chunk_publisher", *_TOPICS)
        receivers = Receivers(processes, Subscription(_TOPICS, 0, "", chunks=True))
        receivers.expect_all()
        publisher.tell(str(effort.published))
        times_us: dict[str, list[float]] = json.loads(publisher.line(_PATIENCE_S))
        publisher.wait()
        receivers.finish()
    node_us, floor_us = times_us["node"], times_us["floor"]
    alone = f"rclpy alone, with a ready message, {statistics.median(floor_us):.0f} us"
    figures = [
        Figure("full chunk, median", statistics.median(node_us), "us", _MEDIAN_US, alone),
        Figure("full chunk, p90", statistics.quantiles(node_us, n=10)[-1], "us"),
    ]
    title = f"publishing a chunk of {SAMPLES} x {CHANNELS} values"
    return Measurement(title, figures, {"times_us": times_us})
