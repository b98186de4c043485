"""Many streams of which only the chunks are read: loss, CPU and memory of the node."""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.effort import Effort
from benchmarks.figures import Figure, Measurement, Target
from benchmarks.processes import CpuMeter, Processes, ports_for
from benchmarks.receivers import Receivers
from benchmarks.ros_receiver import Subscription
from benchmarks.samples import Passage, passage, topic_of
from benchmarks.senders import BLOCK, BLOCK_STREAMS_PER_PROCESS, STREAMS_PER_PROCESS, Senders

_LOST = Target(0)


@dataclass(frozen=True, slots=True)
class Case:
    """What is sent, and what the node may take for it."""

    streams: int
    # block, per_process: see `Senders`.
    block: int
    per_process: int
    cpu: Target
    memory: Target


USUAL = Case(64, 1, STREAMS_PER_PROCESS, Target(60.0), Target(250.0))
MANY = Case(256, BLOCK, BLOCK_STREAMS_PER_PROCESS, Target(75.0), Target(500.0))


@dataclass(frozen=True, slots=True)
class Load:
    """What the node did and cost.

    Attributes
    ----------
    passage
        Of samples; the latency is that of whole chunks, so half a second at most.
    node_cpu_percent, subscriber_cpu_percent, sender_cpu_percent
        Of one core; the busiest of the senders.
    late_p99_ms
        How long after its due time a sample was pushed.
    """

    passage: Passage
    node_cpu_percent: float
    node_memory_mb: float
    node_threads: int
    subscriber_cpu_percent: float
    sender_cpu_percent: float
    late_p50_ms: float
    late_p99_ms: float


def measure(effort: Effort) -> Measurement:
    """Measure once: there is no floor to compare with."""
    return _measured(USUAL, effort)


def measure_many(effort: Effort) -> Measurement:
    """Measure four times as many, with samples in blocks."""
    return _measured(MANY, effort)


def _measured(case: Case, effort: Effort) -> Measurement:
    sys.stderr.write(f"  {case.streams} streams\n")
    return _measurement(case, _load(case, effort.chunks_s, effort.settle_s))


def _load(case: Case, seconds: float, settle_s: float) -> Load:
    ports = ports_for(case.streams)
    with tempfile.TemporaryDirectory() as name, Processes(Path(name), ports) as processes:
        node = processes.start_node()
        senders = Senders(
            processes,
            case.streams,
            per_process=case.per_process,
            frugal=True,
            block=case.block,
        )
        topics = [f"{topic_of(each)}_chunk" for each in senders.names]
        subscription = Subscription(topics, senders.count(seconds), "", chunks=True)
        receivers = Receivers(processes, subscription)
        senders.expect_up()
        receivers.expect_all()
        time.sleep(settle_s)
        meter = CpuMeter(node)
        receivers.start_meters()
        sent = senders.send(seconds)
        node_cpu, subscriber_cpu = meter.percent(), receivers.cpu_percent()
        memory_mb, threads = node.memory_mb, node.threads
        arrived, repeated = receivers.finish()
        node.stop()
        senders.finish()
        result = passage(sent.times, arrived, repeated)
        late = sent.late_p50_ms, sent.late_p99_ms
        return Load(result, node_cpu, memory_mb, threads, subscriber_cpu, sent.cpu_percent, *late)


def _measurement(case: Case, load: Load) -> Measurement:
    lost_note = f"of {load.passage.sent}, {load.passage.repeated} repeated"
    late = f"pushed {load.late_p99_ms:.2f} ms late (p99)"
    figures = [
        Figure("lost", load.passage.lost, "", _LOST, lost_note),
        Figure("CPU of lsl_to_ros", load.node_cpu_percent, "%", case.cpu, "of one core"),
        Figure(
            "memory of lsl_to_ros",
            load.node_memory_mb,
            "MB",
            case.memory,
            f"resident, {load.node_threads} threads",
        ),
        Figure("CPU of the subscriber", load.subscriber_cpu_percent, "%"),
        Figure("busiest sender", load.sender_cpu_percent, "%", note=late),
    ]
    return Measurement(f"{case.streams} streams, only chunks read", figures, asdict(load))
