"""Thirty streams that nobody reads: CPU of the node against bare draining."""

from __future__ import annotations

import statistics
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.effort import Effort
from benchmarks.figures import Figure, Measurement, Target
from benchmarks.processes import BenchError, CpuMeter, Processes
from benchmarks.rounds import in_rounds
from benchmarks.samples import RATE_HZ
from benchmarks.senders import Senders

STREAMS = 30
_CPU_RATIO = Target(1.5)
_PATIENCE_S = 60.0
# The rest of what was sent is still on its way when the counting ends.
_LEAST_DRAINED = 0.9


@dataclass(frozen=True, slots=True)
class Leg:
    """One round, with the node or without."""

    cpu_percent: float  # Of one core, of the receiving process: the node, or pylsl alone.
    sender_cpu_percent: float  # Of the busiest.
    late_p99_ms: float  # How long after its due time a sample was pushed.


def measure(effort: Effort) -> Measurement:
    """Measure the node and its floor in turn."""
    legs = {"floor": _floor, "node": _node}
    rounds = in_rounds(legs, effort.rounds, effort.idle_s, effort.settle_s)
    return _measurement(rounds["floor"], rounds["node"])


def _floor(seconds: float, settle_s: float) -> Leg:
    with tempfile.TemporaryDirectory() as name, Processes(Path(name)) as processes:
        senders = Senders(processes, STREAMS, frugal=True)
        floor = processes.start("benchmarks.lsl_receiver", "drain", str(STREAMS))
        senders.expect_up()
        floor.expect("connected")
        time.sleep(settle_s)
        floor.tell()
        before = int(floor.expect("drained")[0])
        meter = CpuMeter(floor)
        sent = senders.send(seconds)
        cpu_percent = meter.percent()
        floor.tell()
        drained = int(floor.expect("drained")[0]) - before
        if drained < _LEAST_DRAINED * seconds * RATE_HZ * STREAMS:
            raise BenchError(f"pylsl alone drained only {drained} samples")
        floor.wait()
        senders.finish()
        return Leg(cpu_percent, sent.cpu_percent, sent.late_p99_ms)


def _node(seconds: float, settle_s: float) -> Leg:
    with tempfile.TemporaryDirectory() as name, Processes(Path(name)) as processes:
        node = processes.start_node()
        senders = Senders(processes, STREAMS, frugal=True)
        watcher = processes.start("benchmarks.graph_watcher", str(STREAMS))
        senders.expect_up()
        watcher.expect("ready")
        watcher.expect("graph", _PATIENCE_S)
        watcher.expect("diagnostics", _PATIENCE_S)
        watcher.wait()
        time.sleep(settle_s)
        meter = CpuMeter(node)
        sent = senders.send(seconds)
        cpu_percent = meter.percent()
        node.stop()
        senders.finish()
        return Leg(cpu_percent, sent.cpu_percent, sent.late_p99_ms)


def _measurement(floor: list[Leg], node: list[Leg]) -> Measurement:
    ratios = [a.cpu_percent / b.cpu_percent for a, b in zip(node, floor, strict=True)]
    cpu = statistics.median(leg.cpu_percent for leg in node)
    floor_cpu = statistics.median(leg.cpu_percent for leg in floor)
    sender = max(leg.sender_cpu_percent for leg in floor + node)
    late = f"pushed {max(leg.late_p99_ms for leg in floor + node):.2f} ms late (p99)"
    span = f"{min(ratios):.2f} to {max(ratios):.2f} by round"
    figures = [
        Figure("CPU of lsl_to_ros", cpu, "%", note=f"pylsl alone {floor_cpu:.1f} %"),
        Figure("CPU, as a multiple of pylsl", statistics.median(ratios), "", _CPU_RATIO, span),
        Figure("busiest sender", sender, "%", note=late),
    ]
    details = {"floor": [asdict(leg) for leg in floor], "node": [asdict(leg) for leg in node]}
    return Measurement(f"{STREAMS} streams, none read", figures, details)
