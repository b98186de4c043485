"""``python -m benchmarks [--quick] [--only NAME...] [--skip NAME...] [--json FILE]``."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks import (
    agent_figures,
    bursts,
    chunks,
    churn,
    clock_accuracy,
    command_line,
    export,
    features,
    hundred_outlets,
    idle,
    machine,
    many,
    one_stream,
    page,
    page_growth,
    publish,
    replay,
    report,
    restart,
    ros_to_lsl,
    sixteen_streams,
    staying,
)
from benchmarks.effort import FULL, QUICK, Effort
from benchmarks.figures import Measurement
from benchmarks.processes import BenchError
from biosensor_gateway.settings.models import LogSettings
from biosensor_gateway.system.logs import configure_logs

MEASUREMENTS: dict[str, Callable[[Effort], Measurement]] = {
    "one": one_stream.measure,
    "sixteen": sixteen_streams.measure,
    "many": many.measure,
    "chunks": chunks.measure,
    "many_chunks": chunks.measure_many,
    "idle": idle.measure,
    "hundred": hundred_outlets.measure,
    "bursts": bursts.measure,
    "bursts_in_c": bursts.measure_in_c,
    "publish": publish.measure,
    "ros_to_lsl": ros_to_lsl.measure,
    "restart": restart.measure,
    "churn": churn.measure,
    "staying": staying.measure,
    "agent": agent_figures.measure_agent,
    "features": features.measure,
    "page": page.measure,
    "page_growth": page_growth.measure,
    "decoders": agent_figures.measure_decoders,
    "clock": clock_accuracy.measure,
    "doors": command_line.measure,
    "export": export.measure,
    "replay": replay.measure,
}


def _run(names: Sequence[str], effort: Effort) -> tuple[report.BenchRun, list[str]]:
    """Measure; return the figures, and for each measurement that failed, why."""
    load, begin_s = machine.load(), time.monotonic()
    measurements: dict[str, Measurement] = {}
    failures: list[str] = []
    for name in names:
        sys.stderr.write(f"{name}\n")
        try:
            measurements[name] = MEASUREMENTS[name](effort)
        except BenchError as error:
            failures.append(f"{name}: {error}")
    seconds = time.monotonic() - begin_s
    loads = load, machine.load()
    return report.BenchRun(machine.facts(), loads, seconds, measurements), failures


def main() -> None:
    """Measure, print and write; exit code 1 if a process failed, never for a missed target."""
    arguments = argparse.ArgumentParser(prog="benchmarks", description=__doc__)
    arguments.add_argument("--quick", action="store_true", help="short and rough")
    arguments.add_argument("--only", nargs="+", choices=list(MEASUREMENTS), metavar="NAME")
    arguments.add_argument("--skip", nargs="+", choices=list(MEASUREMENTS), metavar="NAME")
    arguments.add_argument("--json", type=Path, default=Path("build/bench.json"), metavar="FILE")
    options = arguments.parse_args()
    configure_logs(LogSettings(level="error"), None)
    chosen = options.only or list(MEASUREMENTS)
    names = [name for name in chosen if name not in (options.skip or ())]
    run, failures = _run(names, QUICK if options.quick else FULL)
    report.show(run)
    report.write(run, options.json)
    if failures:
        raise SystemExit("\n".join(failures))


if __name__ == "__main__":
    main()
