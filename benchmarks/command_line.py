"""What it takes to ask the program for its version, its help, and the help of a command."""

from __future__ import annotations

import os
import statistics
import sys

from benchmarks.effort import Effort
from benchmarks.figures import Figure, Measurement, Target
from benchmarks.processes import BenchError

RUNS = 10
_LIMITS = {
    "--version": Target(0.4),
    "--help": Target(0.4),
    # Typer imports pydantic for a command's arguments.
    "run --help": Target(0.6),
    "stop --help": Target(0.6),
    "pause --help": Target(0.6),
}


def measure(effort: Effort) -> Measurement:
    """Measure the CPU time of each, user and system."""
    del effort
    took = {option: [_cpu_s(option) for _ in range(RUNS)] for option in _LIMITS}
    figures = [_figure(option, seconds) for option, seconds in took.items()]
    return Measurement("biosensor-gateway, CPU time of one call", figures, took)


def _figure(option: str, seconds: list[float]) -> Figure:
    span = f"{min(seconds):.2f} to {max(seconds):.2f} by call"
    return Figure(option, statistics.median(seconds), "s", _LIMITS[option], span)


def _cpu_s(option: str) -> float:
    program = [sys.executable, "-m", "biosensor_gateway.cli", *option.split()]
    silence = [(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)]
    process = os.posix_spawn(sys.executable, program, os.environ, file_actions=silence)
    _, status, usage = os.wait4(process, 0)
    if status:
        raise BenchError(f"biosensor-gateway {option} failed")
    return usage.ru_utime + usage.ru_stime
