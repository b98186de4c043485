"""What it takes to ask the program for its version and for its help."""

from __future__ import annotations

import os
import statistics
import sys

from tests.bench.effort import Effort
from tests.bench.figures import Figure, Measurement, Target
from tests.bench.processes import BenchError

RUNS = 10
_LIMIT = Target(0.4)
_OPTIONS = ("--version", "--help")


def measure(effort: Effort) -> Measurement:
    """Measure the CPU time of each, user and system."""
    del effort
    took = {option: [_cpu_s(option) for _ in range(RUNS)] for option in _OPTIONS}
    figures = [_figure(option, seconds) for option, seconds in took.items()]
    return Measurement("biosensor-gateway, CPU time of one call", figures, took)


def _figure(option: str, seconds: list[float]) -> Figure:
    span = f"{min(seconds):.2f} to {max(seconds):.2f} by call"
    return Figure(option, statistics.median(seconds), "s", _LIMIT, span)


def _cpu_s(option: str) -> float:
    program = [sys.executable, "-m", "biosensor_gateway.cli", option]
    silence = [(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)]
    process = os.posix_spawn(sys.executable, program, os.environ, file_actions=silence)
    _, status, usage = os.wait4(process, 0)
    if status:
        raise BenchError(f"biosensor-gateway {option} failed")
    return usage.ru_utime + usage.ru_stime
