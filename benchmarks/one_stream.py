"""One stream: the latency of the node, against LSL alone and DDS alone."""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.effort import Effort
from benchmarks.figures import Figure, Measurement, Target
from benchmarks.lsl_sender import Offer
from benchmarks.processes import CpuMeter, Process, Processes
from benchmarks.receivers import finish
from benchmarks.ros_receiver import Subscription
from benchmarks.rounds import in_rounds
from benchmarks.samples import RATE_HZ, Passage, passage, stream_names, topic_of

_FLOOR_TOPIC = "/bench_floor"
_RATIO, _P99_MS = Target(1.25), Target(5.0)


@dataclass(frozen=True, slots=True)
class Leg:
    """One round of one way."""

    passage: Passage
    # Of one core, for the node's process; None for a way without it.
    node_cpu_percent: float | None


def measure(effort: Effort) -> Measurement:
    """Measure the three ways in turn."""
    return _measurement(in_rounds(_WAYS, effort.rounds, effort.one_s, effort.settle_s))


def _lsl(processes: Processes, count: int, file: Path) -> tuple[Process, Process, None]:
    source = processes.start(*Offer(stream_names(1)).as_arguments())
    source.expect("up")
    receiver = ["benchmarks.lsl_receiver", "read", "1", str(count), str(file)]
    return source, processes.start(*receiver), None


def _dds(processes: Processes, count: int, file: Path) -> tuple[Process, Process, None]:
    subscription = Subscription([_FLOOR_TOPIC], count, str(file), usual=True)
    source = processes.start("benchmarks.ros_sender", _FLOOR_TOPIC)
    return source, processes.start(*subscription.as_arguments()), None


def _node(processes: Processes, count: int, file: Path) -> tuple[Process, Process, Process]:
    node = processes.start_node()
    source = processes.start(*Offer(stream_names(1)).as_arguments())
    source.expect("up")
    subscription = Subscription(
        [topic_of(name) for name in stream_names(1)], count, str(file), usual=True
    )
    return source, processes.start(*subscription.as_arguments()), node


def _leg(
    start: Callable[[Processes, int, Path], tuple[Process, Process, Process | None]],
) -> Callable[[float, float], Leg]:
    def run(seconds: float, settle_s: float) -> Leg:
        count = round(seconds * RATE_HZ)
        with tempfile.TemporaryDirectory() as name, Processes(Path(name)) as processes:
            sent_file, arrived_file = Path(name, "sent.npy"), Path(name, "arrived.npy")
            source, sink, node = start(processes, count, arrived_file)
            sink.expect("connected")
            time.sleep(settle_s)
            meter = CpuMeter(node) if node else None
            source.tell(f"{count} {sent_file}")
            source.expect("sent", patience_s=seconds + 30)
            cpu_percent = meter.percent() if meter else None
            repeated = finish([sink])
            if node is not None:
                node.stop()
            source.wait()
            sent, arrived = np.load(sent_file)[0], np.load(arrived_file)
            return Leg(passage(sent, arrived, repeated), cpu_percent)

    return run


_WAYS = {"LSL": _leg(_lsl), "DDS": _leg(_dds), "lsl_to_ros": _leg(_node)}


def _measurement(rounds: dict[str, list[Leg]]) -> Measurement:
    figures = [figure for way, legs in rounds.items() for figure in _latencies(way, legs)]
    ways = zip(rounds["LSL"], rounds["DDS"], rounds["lsl_to_ros"], strict=True)
    ratios = [
        node.passage.p50_ms / (lsl.passage.p50_ms + dds.passage.p50_ms) for lsl, dds, node in ways
    ]
    span = f"{min(ratios):.2f} to {max(ratios):.2f} by round"
    ratio = statistics.median(ratios)
    figures.append(Figure("p50 of lsl_to_ros / (LSL + DDS)", ratio, "", _RATIO, span))
    shares = [leg.node_cpu_percent or 0.0 for leg in rounds["lsl_to_ros"]]
    figures.append(Figure("CPU of lsl_to_ros", statistics.median(shares), "%", note="of one core"))
    details = {way: [asdict(leg) for leg in legs] for way, legs in rounds.items()}
    return Measurement("one stream, 8 channels at 256 Hz", figures, {**details, "ratios": ratios})


def _latencies(way: str, legs: Sequence[Leg]) -> list[Figure]:
    passages = [leg.passage for leg in legs]
    lost, sent = sum(each.lost for each in passages), sum(each.sent for each in passages)
    p50 = statistics.median(each.p50_ms for each in passages)
    p99 = statistics.median(each.p99_ms for each in passages)
    target = _P99_MS if way == "lsl_to_ros" else None
    return [
        Figure(f"{way}, p50", p50, "ms", note=f"{lost} of {sent} lost"),
        Figure(f"{way}, p99", p99, "ms", target),
    ]
