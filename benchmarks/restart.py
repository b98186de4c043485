"""The node is killed, outlets are killed: how long until topics flow again."""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks.effort import Effort
from benchmarks.figures import Figure, Measurement, Target
from benchmarks.lsl_sender import Offer
from benchmarks.processes import Process, Processes
from benchmarks.samples import RATE_HZ, stream_names, topic_of

_FLOWS_S = Target(2.0)
_STREAMS = 4
# What the old node sent has arrived by then.
_PAUSE_S = 0.5


@dataclass(frozen=True, slots=True)
class Comeback:
    """How an outlet comes back, and as what it went."""

    title: str
    source_id: str
    rate_hz: float = RATE_HZ


# Each begins where the one before it ended; the first offer is like the last comeback.
_COMEBACKS = (
    Comeback("with the same source_id", "first"),
    Comeback("without a source_id", ""),
    Comeback("again without a source_id", ""),
    Comeback("with a new source_id", "first"),
    Comeback("with another rate", "first", RATE_HZ / 2),
    Comeback("with another source_id and rate", "second"),
)
_FIRST = Comeback("at first", "first")


def measure(effort: Effort) -> Measurement:
    """Kill and restart each, the node and the outlet."""
    sys.stderr.write("  the node\n")
    times = {"lsl_to_ros": _node(effort.node_restarts)}
    sys.stderr.write("  an outlet\n")
    times |= _outlet(effort.restarts)
    figures = [_figure(title, each) for title, each in times.items()]
    return Measurement("killed and restarted: flows again after", figures, times)


def _figure(title: str, times_s: list[float]) -> Figure:
    # The slowest one counts: a robot waits each time.
    middle = f"worst of {len(times_s)}, median {statistics.median(times_s):.2f} s"
    note = middle if len(times_s) > 1 else ""
    return Figure(title, max(times_s), "s", _FLOWS_S, note)


def _node(repeats: int) -> list[float]:
    """Restart the node; return the seconds from its start until all topics flow."""
    times: list[float] = []
    with tempfile.TemporaryDirectory() as name, Processes(Path(name)) as processes:
        names = stream_names(_STREAMS)
        source = processes.start(*Offer(names, filler=0.0).as_arguments())
        source.expect("up")
        node = processes.start_node()
        watcher = _watcher(processes, names)
        for _ in range(repeats):
            node.kill()
            time.sleep(_PAUSE_S)
            watcher.tell("0")
            begin_s = time.monotonic()
            node = processes.start_node()
            times.append(float(watcher.expect("flows")[0]) - begin_s)
        watcher.wait()
        node.stop()
        source.wait()
    return times


def _outlet(repeats: int) -> dict[str, list[float]]:
    """Restart an outlet in every way; return the seconds from its being up."""
    times: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as name, Processes(Path(name)) as processes:
        node = processes.start_node()
        source = _offer(processes, _FIRST, 0)
        source.expect("up")
        watcher = _watcher(processes, stream_names(1))
        for number, comeback in enumerate(repeats * _COMEBACKS, start=1):
            watcher.tell(str(number))
            source.kill()
            source = _offer(processes, comeback, number)
            up_s = float(source.expect("up")[0])
            flows_s = float(watcher.expect("flows")[0])
            times.setdefault(f"outlet {comeback.title}", []).append(flows_s - up_s)
        watcher.wait()
        node.stop()
        source.wait()
    return times


def _offer(processes: Processes, comeback: Comeback, number: int) -> Process:
    offer = Offer(stream_names(1), comeback.rate_hz, comeback.source_id, filler=float(number))
    return processes.start(*offer.as_arguments())


def _watcher(processes: Processes, names: list[str]) -> Process:
    watcher = processes.start("benchmarks.flow_watcher", *(topic_of(name) for name in names))
    watcher.tell("0")
    watcher.expect("flows")
    return watcher
