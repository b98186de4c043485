"""What live features cost, and how late a beat is in ROS."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.agent_load import SENSORS, streaming_agent
from benchmarks.effort import Effort
from benchmarks.figures import Figure, Measurement, Target
from benchmarks.processes import CpuMeter

_CPU_OF_SEVEN, _LATE_S = Target(8.0), Target(0.4)
# Detectors learn for some seconds before they tell a beat.
_LEARNT_S, _FOUND_S = 20.0, 120.0
# Agent and features have some 200 outlets; one beyond the range is not found.
_PORT_RANGE = 1024


def measure(effort: Effort) -> Measurement:
    """Run features and node beside an agent with a virtual device of every kind."""
    with streaming_agent(_PORT_RANGE) as (_, processes):
        features = processes.start("biosensor_gateway.cli", "features")
        node = processes.start_node()
        time.sleep(_LEARNT_S)
        listener = processes.start("benchmarks.features_role")
        listener.expect("streaming", _FOUND_S)
        listener.tell()
        listener.expect("measuring")
        meter = CpuMeter(features)
        time.sleep(effort.features_s)
        cpu_percent, memory_mb = meter.percent(), features.memory_mb
        listener.tell()
        found: list[dict[str, Any]] = json.loads(listener.line())
        listener.wait()
        node.stop()
        features.stop()
    of = f"of one core; {cpu_percent:.1f} % with all {len(SENSORS)}"
    figures = [
        Figure("CPU of features, for seven devices", cpu_percent * 7 / len(SENSORS), "%",
               _CPU_OF_SEVEN, of),
        Figure("its memory", memory_mb, "MB", note="resident"),
        Figure("topics of beats", len(found), ""),
        *(figure for each in found for figure in _figures(each)),
    ]  # fmt: skip
    return Measurement("live features of a virtual device of every kind", figures, {"late": found})


def _figures(topic: dict[str, Any]) -> Iterator[Figure]:
    beats_s, samples_s = topic["beats_s"], topic["samples_s"]
    if not beats_s or not samples_s:
        return
    late_s, packet_s = np.percentile(beats_s, 95), np.percentile(samples_s, 95)
    note = (
        f"{late_s:.2f} s in the subscriber, {packet_s:.2f} s of them the device's packets; "
        f"{len(beats_s)} beats from {topic['from_type']}"
    )
    yield Figure(f"{topic['topic']}, p95", float(late_s - packet_s), "s", _LATE_S, note)
