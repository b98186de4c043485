"""What ``ros_to_lsl`` costs with twenty topics, and how long a message takes through it."""

from __future__ import annotations

import json
import statistics
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.effort import Effort
from benchmarks.figures import Figure, Measurement, Target
from benchmarks.processes import BenchError, CpuMeter, Processes

TOPICS, RATE_HZ = 20, 100
_CPU, _P99_MS, _LOST = Target(25.0), Target(2.0), Target(0)
_STREAMING_S = 30.0


@dataclass(frozen=True, slots=True)
class Leg:
    """One round."""

    cpu_percent: float  # Of one core, of the node's process.
    # taken_p99_ms, arrived_p50_ms, arrived_p99_ms: to the end of the push, from when the node has
    # taken a message, and from when DDS has received it.
    taken_p99_ms: float
    arrived_p50_ms: float
    arrived_p99_ms: float
    # published, pushed: messages in the same time.
    published: int
    pushed: int


def measure(effort: Effort) -> Measurement:
    """Measure as often as every comparison is made; the figures are medians."""
    legs = [_leg(effort.sixteen_s, effort.settle_s) for _ in range(effort.rounds)]

    def median(name: str) -> float:
        return statistics.median(getattr(leg, name) for leg in legs)

    lost = sum(leg.published - leg.pushed for leg in legs)
    of = f"of {sum(leg.published for leg in legs)} messages"
    figures = [
        Figure("CPU of ros_to_lsl", median("cpu_percent"), "%", _CPU, "of one core"),
        Figure("taken to pushed, p99", median("taken_p99_ms"), "ms", _P99_MS),
        Figure("DDS has it to pushed, p50", median("arrived_p50_ms"), "ms"),
        Figure("DDS has it to pushed, p99", median("arrived_p99_ms"), "ms"),
        Figure("lost", lost, "", _LOST, of),
    ]
    title = f"{TOPICS} topics of JointState with 7 joints, at {RATE_HZ} Hz, as LSL streams"
    return Measurement(title, figures, {"legs": [asdict(leg) for leg in legs]})


def _leg(seconds: float, settle_s: float) -> Leg:
    with tempfile.TemporaryDirectory() as name, Processes(Path(name)) as processes:
        robot = processes.start("benchmarks.robot_sender", str(TOPICS), str(RATE_HZ))
        node = processes.start("benchmarks.ros_to_lsl_role", str(TOPICS))
        node.expect("streaming", _STREAMING_S)
        time.sleep(settle_s)
        robot.tell()
        robot.expect("resting")
        node.tell()
        node.expect("measuring")
        robot.tell()
        meter = CpuMeter(node)
        time.sleep(seconds)
        robot.tell()
        cpu_percent = meter.percent()
        (published,) = map(int, robot.expect("published"))
        node.tell()
        found = json.loads(node.line())
        robot.wait()
        node.wait()
    if found["pushed"] < published / 2:
        raise BenchError(f"of {published} messages {found['pushed']} were pushed")
    taken, arrived = sorted(found["taken_ms"]), sorted(found["arrived_ms"])
    return Leg(
        cpu_percent=cpu_percent,
        taken_p99_ms=taken[int(0.99 * len(taken))],
        arrived_p50_ms=statistics.median(arrived),
        arrived_p99_ms=arrived[int(0.99 * len(arrived))],
        published=published,
        pushed=found["pushed"],
    )
