"""Measurements of one run, as a table and as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from benchmarks.figures import Figure, Measurement


@dataclass(frozen=True, slots=True)
class BenchRun:
    """All that one run measured."""

    machine: Mapping[str, str]
    load: tuple[float, float]  # Load average at start and end.
    seconds: float
    measurements: Mapping[str, Measurement]  # By name, in the order of time.


def write(run: BenchRun, file: Path) -> None:
    """Write everything as JSON."""
    content = {
        "machine": dict(run.machine),
        "load": run.load,
        "seconds": run.seconds,
        "measurements": {name: _as_json(each) for name, each in run.measurements.items()},
    }
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(content, indent=2) + "\n")


def show(run: BenchRun) -> None:
    """Print one table and the conditions of the run."""
    table = Table(box=SIMPLE_HEAD)
    table.add_column("measurement", no_wrap=True)
    table.add_column("value", justify="right", no_wrap=True)
    table.add_column("target", justify="right", no_wrap=True)
    table.add_column("verdict")
    table.add_column("")
    for measurement in run.measurements.values():
        table.add_row(f"[bold]{measurement.title}")
        for figure in measurement.figures:
            _add(table, figure)
        table.add_section()
    console = Console(highlight=False, width=120)
    console.print(table)
    console.print(", ".join(f"{key} {value}" for key, value in run.machine.items()))
    start, end = run.load
    console.print(f"load average {start} at the start, {end} at the end, {run.seconds:.0f} s")


def _add(table: Table, figure: Figure) -> None:
    target = "" if figure.target is None else str(figure.target)
    value = f"{_rounded(figure.value)} {figure.unit}".rstrip()
    table.add_row(f"  {figure.title}", value, target, figure.verdict, figure.note)


def _rounded(value: float) -> str:
    """Return at least three significant digits."""
    return f"{value:.0f}" if abs(value) >= 100 or value == int(value) else f"{value:.3g}"


def _as_json(measurement: Measurement) -> dict[str, Any]:
    figures = [asdict(figure) | {"verdict": figure.verdict} for figure in measurement.figures]
    details = dict(measurement.details)
    return {"title": measurement.title, "figures": figures, "details": details}
