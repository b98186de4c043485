"""The node with more and more streams: loss, latency, CPU, memory."""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from benchmarks.effort import Effort
from benchmarks.figures import Figure, Measurement, Target
from benchmarks.processes import Processes, ports_for
from benchmarks.receivers import Receivers
from benchmarks.ros_receiver import Subscription
from benchmarks.rounds import in_rounds
from benchmarks.samples import Passage, passage, topic_of
from benchmarks.senders import BLOCK, BLOCK_STREAMS_PER_PROCESS, Senders

STREAMS = (64, 128)
_LOST = Target(0)
_SUBSCRIBERS = 2


@dataclass(frozen=True, slots=True)
class Leg:
    """One round with so many streams."""

    passage: Passage
    cpu_s: float  # CPU time of the node.
    seconds: float  # From the first sample to the last.
    memory_mb: float
    late_p99_ms: float  # How long after its due time a sample was pushed.

    @property
    def us_a_sample(self) -> float:
        """CPU time of the node, which says something on a busy machine, too."""
        return 1e6 * self.cpu_s / self.passage.sent


def measure(effort: Effort) -> Measurement:
    """Measure each number of streams in turn, with samples in blocks."""
    legs = {f"{streams} streams": partial(_leg, streams) for streams in STREAMS}
    rounds = in_rounds(legs, effort.rounds, effort.sixteen_s, effort.settle_s)
    figures = [figure for name, each in rounds.items() for figure in _figures(name, each)]
    details = {name: [asdict(leg) for leg in each] for name, each in rounds.items()}
    title = f"many streams, every sample read, {BLOCK} sent at once"
    return Measurement(title, figures, details)


def _leg(streams: int, seconds: float, settle_s: float) -> Leg:
    ports = ports_for(streams)
    with tempfile.TemporaryDirectory() as name, Processes(Path(name), ports) as processes:
        node = processes.start_node()
        # What the senders take is not left for the node.
        per_process = BLOCK_STREAMS_PER_PROCESS
        senders = Senders(processes, streams, per_process=per_process, frugal=True, block=BLOCK)
        subscription = Subscription(
            [topic_of(each) for each in senders.names], senders.count(seconds), ""
        )
        receivers = Receivers(processes, subscription, _SUBSCRIBERS)
        senders.expect_up()
        receivers.expect_all()
        time.sleep(settle_s)
        before, begin_s = node.cpu_s, time.monotonic()
        sent = senders.send(seconds)
        took_s = time.monotonic() - begin_s
        cpu_s, memory_mb = node.cpu_s - before, node.memory_mb
        arrived, repeated = receivers.finish()
        node.stop()
        senders.finish()
        result = passage(sent.times, arrived, repeated)
        return Leg(result, cpu_s, took_s, memory_mb, sent.late_p99_ms)


def _figures(title: str, legs: Sequence[Leg]) -> list[Figure]:
    lost, sent = sum(leg.passage.lost for leg in legs), sum(leg.passage.sent for leg in legs)
    repeated = sum(leg.passage.repeated for leg in legs)
    p50 = statistics.median(leg.passage.p50_ms for leg in legs)
    p99 = statistics.median(leg.passage.p99_ms for leg in legs)
    cpu = statistics.median(100 * leg.cpu_s / leg.seconds for leg in legs)
    us = statistics.median(leg.us_a_sample for leg in legs)
    memory_mb = max(leg.memory_mb for leg in legs)
    late = max(leg.late_p99_ms for leg in legs)
    return [
        Figure(f"{title}: lost", lost, "", _LOST, f"of {sent}, {repeated} repeated"),
        Figure("p50", p50, "ms"),
        Figure("p99", p99, "ms", note=f"pushed {late:.2f} ms late (p99)"),
        Figure("CPU", cpu, "%"),
        Figure("CPU a sample", us, "µs"),
        Figure("memory", memory_mb, "MB", note="resident"),
    ]
