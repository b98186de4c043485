"""The three ways of a sample that are compared."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.bench.processes import Process, Processes
from tests.bench.roles import RATE_HZ

_LSL, _ROS, _NODE = "tests.bench.lsl_roles", "tests.bench.ros_roles", "lsl_to_ros.node"
_FLOOR_TOPIC, _NODE_TOPIC = "/bench_floor", "/biosensors/bench/EEG"
# Discovery traffic of the just started processes is over by then.
_WARM_UP_S = 1.0
_LAST_SAMPLES_S = 0.5


@dataclass(frozen=True, slots=True)
class Round:
    """One round of one leg.

    Attributes
    ----------
    p50_ms, p99_ms
        Latency from just before the sender's call to the receiver's first statement.
    sent, lost
        Samples.
    node_cpu_percent
        Of one core, for the node's process; None for a leg without one.
    """

    p50_ms: float
    p99_ms: float
    sent: int
    lost: int
    node_cpu_percent: float | None


def lsl_floor(seconds: float) -> Round:
    """Measure outlet to inlet."""
    return _measure([_LSL, "send"], [_LSL, "receive"], seconds)


def dds_floor(seconds: float) -> Round:
    """Measure publisher to subscriber."""
    return _measure([_ROS, "send", _FLOOR_TOPIC], [_ROS, "receive", _FLOOR_TOPIC], seconds)


def node(seconds: float) -> Round:
    """Measure outlet to subscriber, through ``lsl_to_ros``."""
    return _measure([_LSL, "send"], [_ROS, "receive", _NODE_TOPIC], seconds, between=[_NODE])


LEGS: dict[str, Callable[[float], Round]] = {"lsl": lsl_floor, "dds": dds_floor, "node": node}


def _measure(
    sender: list[str], receiver: list[str], seconds: float, between: list[str] | None = None
) -> Round:
    count = round(seconds * RATE_HZ)
    with tempfile.TemporaryDirectory() as name, Processes(Path(name)) as processes:
        sent_file, arrived_file = Path(name, "sent"), Path(name, "arrived")
        middle = processes.start(*between) if between else None
        source = processes.start(*sender, str(count), str(sent_file))
        sink = processes.start(*receiver, str(count), str(arrived_file))
        source.expect("sending")
        sink.expect("connected")
        time.sleep(_WARM_UP_S)
        cpu_percent = _run(source, middle, seconds)
        time.sleep(_LAST_SAMPLES_S)
        sink.wait()
        if middle is not None:
            middle.interrupt()
            middle.wait()
        source.wait()
        return _joined(sent_file, arrived_file, cpu_percent)


def _run(source: Process, middle: Process | None, seconds: float) -> float | None:
    begin, cpu_s = time.monotonic(), middle.cpu_s if middle else 0.0
    source.tell()
    source.expect("sent", patience_s=seconds + 30)
    if middle is None:
        return None
    return 100 * (middle.cpu_s - cpu_s) / (time.monotonic() - begin)


def _joined(sent_file: Path, arrived_file: Path, cpu_percent: float | None) -> Round:
    sent, arrived = np.fromfile(sent_file), np.fromfile(arrived_file)
    latency_ms = 1e3 * (arrived - sent)[~np.isnan(arrived)]
    p50, p99 = np.percentile(latency_ms, (50, 99))
    return Round(float(p50), float(p99), len(sent), len(sent) - len(latency_ms), cpu_percent)
