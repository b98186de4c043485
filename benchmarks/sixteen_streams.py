"""Sixteen streams, every sample read: loss, latency, and CPU against bare receiving."""

from __future__ import annotations

import statistics
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.effort import Effort
from benchmarks.figures import Figure, Measurement, Target
from benchmarks.processes import CpuMeter, Processes
from benchmarks.receivers import Receivers, finish
from benchmarks.ros_receiver import Subscription
from benchmarks.rounds import in_rounds
from benchmarks.samples import Passage, passage, topic_of
from benchmarks.senders import Senders, Sent

STREAMS = 16
_LOST, _P99_MS, _CPU_RATIO = Target(0), Target(10.0), Target(2.0)
_SUBSCRIBER_CPU = Target(70.0)
_SUBSCRIBERS = 2


@dataclass(frozen=True, slots=True)
class Leg:
    """One round, with the node or without."""

    passage: Passage
    cpu_percent: float  # Of one core, of the receiving process: the node, or pylsl alone.
    # sender_cpu_percent, subscriber_cpu_percent: of the busiest of each; no subscriber without the
    # node.
    sender_cpu_percent: float
    subscriber_cpu_percent: float | None
    # late_p50_ms, late_p99_ms: how long after its due time a sample was pushed.
    late_p50_ms: float
    late_p99_ms: float


def measure(effort: Effort) -> Measurement:
    """Measure the node and its floor in turn."""
    legs = {"floor": _floor, "node": _node}
    rounds = in_rounds(legs, effort.rounds, effort.sixteen_s, effort.settle_s)
    return _measurement(rounds["floor"], rounds["node"])


def _floor(seconds: float, settle_s: float) -> Leg:
    with tempfile.TemporaryDirectory() as name, Processes(Path(name)) as processes:
        senders = Senders(processes, STREAMS)
        file = Path(name, "arrived.npy")
        shape = [str(STREAMS), str(senders.count(seconds))]
        floor = processes.start("benchmarks.lsl_receiver", "read", *shape, str(file))
        senders.expect_up()
        floor.expect("connected")
        time.sleep(settle_s)
        meter = CpuMeter(floor)
        sent = senders.send(seconds)
        cpu_percent = meter.percent()
        repeated = finish([floor])
        senders.finish()
        return _leg(sent, passage(sent.times, np.load(file), repeated), cpu_percent, None)


def _node(seconds: float, settle_s: float) -> Leg:
    with tempfile.TemporaryDirectory() as name, Processes(Path(name)) as processes:
        node = processes.start_node()
        senders = Senders(processes, STREAMS)
        subscription = Subscription(
            [topic_of(each) for each in senders.names], senders.count(seconds), ""
        )
        receivers = Receivers(processes, subscription, _SUBSCRIBERS)
        senders.expect_up()
        receivers.expect_all()
        time.sleep(settle_s)
        meter = CpuMeter(node)
        receivers.start_meters()
        sent = senders.send(seconds)
        cpu_percent, subscriber_cpu = meter.percent(), receivers.cpu_percent()
        arrived, repeated = receivers.finish()
        node.stop()
        senders.finish()
        return _leg(sent, passage(sent.times, arrived, repeated), cpu_percent, subscriber_cpu)


def _leg(sent: Sent, result: Passage, cpu_percent: float, subscriber_cpu: float | None) -> Leg:
    late = sent.late_p50_ms, sent.late_p99_ms
    return Leg(result, cpu_percent, sent.cpu_percent, subscriber_cpu, *late)


def _measurement(floor: list[Leg], node: list[Leg]) -> Measurement:
    passages = [leg.passage for leg in node]
    lost, sent = sum(each.lost for each in passages), sum(each.sent for each in passages)
    repeated = sum(each.repeated for each in passages)
    p50 = statistics.median(each.p50_ms for each in passages)
    p99 = statistics.median(each.p99_ms for each in passages)
    floor_p99 = statistics.median(leg.passage.p99_ms for leg in floor)
    ratios = [a.cpu_percent / b.cpu_percent for a, b in zip(node, floor, strict=True)]
    cpu = statistics.median(leg.cpu_percent for leg in node)
    floor_cpu = statistics.median(leg.cpu_percent for leg in floor)
    subscriber = max(leg.subscriber_cpu_percent or 0.0 for leg in node)
    sender = max(leg.sender_cpu_percent for leg in floor + node)
    late = f"pushed {max(leg.late_p99_ms for leg in floor + node):.2f} ms late (p99)"
    span = f"{min(ratios):.2f} to {max(ratios):.2f} by round"
    figures = [
        Figure("lost", lost, "", _LOST, f"of {sent}, {repeated} repeated"),
        Figure("p50", p50, "ms"),
        Figure("p99", p99, "ms", _P99_MS, f"pylsl alone {floor_p99:.2f} ms"),
        Figure("CPU of lsl_to_ros", cpu, "%", note=f"pylsl alone {floor_cpu:.1f} %"),
        Figure("CPU, as a multiple of pylsl", statistics.median(ratios), "", _CPU_RATIO, span),
        Figure(f"busiest of {_SUBSCRIBERS} subscribers", subscriber, "%", _SUBSCRIBER_CPU),
        Figure("busiest sender", sender, "%", note=late),
    ]
    details = {"floor": [asdict(leg) for leg in floor], "node": [asdict(leg) for leg in node]}
    return Measurement(f"{STREAMS} streams, every sample read", figures, details)
