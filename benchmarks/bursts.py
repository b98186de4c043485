"""What subscribers with short queues get of every virtual device; most send in bursts."""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.agent_load import SENSORS
from benchmarks.effort import Effort
from benchmarks.figures import Figure, Measurement, Target
from benchmarks.processes import BenchError, CpuMeter, Process, Processes
from biosensor_gateway.devices.registry import declaration
from tests.rigs import rcl_subscriber
from tests.rigs.compiler import CompilerError

_LOST = Target(0)
_STARTED_S, _SETTLED_S = 15.0, 3.0


class Queue(NamedTuple):
    """How a subscriber subscribes."""

    depth: int
    reliability: str


class Place(NamedTuple):
    """Where it runs."""

    pace: str = "0.5"  # The node's `burst_pacing`.
    is_busy: bool = False  # Whether programs besides take half of each core.


_IN_PYTHON = ("tests.rigs.tutorial_subscriber",)
_QUEUES = (Queue(5, "best_effort"), Queue(5, "reliable"), Queue(10, "reliable"))
_QUEUES_IN_C = (*_QUEUES[:2], Queue(10, "best_effort"), _QUEUES[2])
_QUIET, _BUSY, _AT_ONCE = Place(), Place(is_busy=True), Place(pace="0.0")


@dataclass(frozen=True, slots=True)
class Leg:
    """What one subscriber got."""

    queue: Queue
    place: Place
    received: int
    missing: dict[str, int]  # Samples that the node got and the subscriber did not, by topic.
    cpu_percent: float  # Of one core, for the subscriber.


def measure(effort: Effort) -> Measurement:
    """Measure each queue, on a quiet and on a half-busy machine, and one without pacing.

    A subscriber in Python needs nearly a whole core, so each has the devices to itself.
    """
    plan = [(queue, place) for place in (_QUIET, _BUSY) for queue in _QUEUES]
    plan.append((_QUEUES[-1], _AT_ONCE))
    runs = [_legs(_IN_PYTHON, (queue,), place, effort.bursts_s) for queue, place in plan]
    return _measurement("one rclpy node", [leg for run in runs for leg in run])


def measure_in_c(effort: Effort) -> Measurement:
    """Measure all queues side by side, by subscribers on rcl, which rclcpp stands on.

    Raises
    ------
    BenchError
        If there is no C compiler.
    """
    with tempfile.TemporaryDirectory() as name:
        try:
            command = ("tests.rigs.rcl_subscriber", str(rcl_subscriber.build(Path(name))))
        except CompilerError as error:
            raise BenchError(str(error)) from error
        places = (_QUIET, _BUSY, _AT_ONCE)
        runs = [_legs(command, _QUEUES_IN_C, place, effort.bursts_s) for place in places]
    return _measurement("each of four subscribers in C", [leg for run in runs for leg in run])


def _measurement(subscriber: str, legs: Sequence[Leg]) -> Measurement:
    title = f"every topic of {len(SENSORS)} devices in {subscriber}, samples lost"
    return Measurement(title, [_figure(leg) for leg in legs], {"legs": [asdict(x) for x in legs]})


def _figure(leg: Leg) -> Figure:
    where = {_QUIET: "", _BUSY: ", half busy", _AT_ONCE: ", without pacing"}[leg.place]
    title = f"depth {leg.queue.depth}, {leg.queue.reliability}{where}"
    target = None if leg.place == _AT_ONCE else _LOST
    note = f"of {leg.received}, CPU {leg.cpu_percent:.0f} %"
    return Figure(title, sum(leg.missing.values()), "", target, note)


def _topics() -> list[str]:
    """Return topic and type of every stream, in turn."""
    streams = [(name, stream) for name in SENSORS for stream in declaration(name).streams]
    return [
        word
        for name, stream in streams
        for word in (f"/biosensors/{name}/{stream.data_name}", stream.message_type.value)
    ]


def _legs(
    command: Sequence[str], queues: Sequence[Queue], place: Place, seconds: float
) -> list[Leg]:
    """Let every device stream for a while to subscribers side by side, one for each queue."""
    with tempfile.TemporaryDirectory() as name, Processes(Path(name)) as processes:
        processes.environment["BIOSENSOR_GATEWAY_STATE"] = str(Path(name, "state"))
        processes.start("lsl_to_ros.node", "--ros-args", "-p", f"burst_pacing:={place.pace}")
        # They are there before the first sample, so that they can have all.
        subscribers = [
            processes.start(*command, str(queue.depth), queue.reliability, *_topics())
            for queue in queues
        ]
        watcher = processes.start("benchmarks.received")
        for each in (*subscribers, watcher):
            _ask(each)
        time.sleep(_SETTLED_S)
        agent = processes.start("biosensor_gateway.cli", "run", "--simulate", "all")
        for _ in range((os.cpu_count() or 1) if place.is_busy else 0):
            processes.start("benchmarks.bursts")
        time.sleep(_STARTED_S)
        meters = [CpuMeter(subscriber) for subscriber in subscribers]
        time.sleep(seconds)
        cpu_percents = [meter.percent() for meter in meters]
        agent.pause()
        time.sleep(_SETTLED_S)
        received, heard = _ask(watcher), [_ask(subscriber) for subscriber in subscribers]
    if not received:
        raise BenchError("nothing came from the virtual devices")
    return [
        _compared(queue, place, received, got, cpu_percent)
        for queue, got, cpu_percent in zip(queues, heard, cpu_percents, strict=True)
    ]


def _compared(
    queue: Queue, place: Place, received: dict[str, int], heard: dict[str, Any], cpu_percent: float
) -> Leg:
    known = {
        topic: count - len(heard[topic]) for topic, count in received.items() if topic in heard
    }
    missing = {topic: lost for topic, lost in known.items() if lost}
    total = sum(received[topic] for topic in known)
    return Leg(queue, place, total, missing, cpu_percent)


def _ask(process: Process) -> dict[str, Any]:
    process.tell("now")
    return json.loads(process.line())


def _be_half_busy() -> None:
    """Take half of a core, in slices of 10 ms, until killed."""
    while True:
        end_s = time.perf_counter() + 0.01
        while time.perf_counter() < end_s:
            pass
        time.sleep(0.01)


if __name__ == "__main__":
    _be_half_busy()
