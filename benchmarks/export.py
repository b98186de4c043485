"""How fast recordings are exported, and how much memory that takes."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks import long_recording
from benchmarks.effort import Effort
from benchmarks.figures import Figure, Measurement, Target
from benchmarks.processes import BenchError
from biosensor_gateway.recording.export.exporter import FORMATS

_SPEEDS = {
    "csv": Target(100, at_least=True),
    "bids": Target(100, at_least=True),
    "mcap": Target(60, at_least=True),
}
_MEMORY = Target(300)


@dataclass(frozen=True, slots=True)
class Export:
    """One export of the recording, by a process of its own."""

    # wall_s, cpu_s: from its start to its end.
    wall_s: float
    cpu_s: float
    peak_mb: float  # The most memory that it held.
    written_mb: float  # What it wrote.


def measure(effort: Effort) -> Measurement:
    """Export a long recording in each format.

    Raises
    ------
    BenchError
        If an export fails.
    """
    with tempfile.TemporaryDirectory() as name:
        recording = Path(name, "study.xdf")
        streams = long_recording.of_a_lab()
        long_recording.write(recording, effort.recording_s, streams)
        size = recording.stat().st_size
        exports = {each: _export(recording, each) for each in FORMATS}
    figures = [
        figure
        for each, export in exports.items()
        for figure in _figures(each, export, effort.recording_s)
    ]
    minutes = effort.recording_s / 60
    title = f"export of {minutes:.0f} min of {len(streams)} streams, {size / 1e6:.0f} MB"
    return Measurement(title, figures, {name: asdict(each) for name, each in exports.items()})


def _export(recording: Path, name: str) -> Export:
    with tempfile.TemporaryDirectory() as folder:
        line = ["-m", "biosensor_gateway.cli", "xdf", "export", str(recording), "--to", name]
        begin_s = time.monotonic()
        process = subprocess.Popen(
            [sys.executable, *line, "--output", folder],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        assert process.stderr is not None
        said = process.stderr.read()
        # Tells also what it took.
        _, status, usage = os.wait4(process.pid, 0)
        wall_s = time.monotonic() - begin_s
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise BenchError(f"the export to {name} failed: {said.decode()}")
        written = sum(each.stat().st_size for each in Path(folder).rglob("*") if each.is_file())
    cpu_s = usage.ru_utime + usage.ru_stime
    return Export(wall_s, cpu_s, usage.ru_maxrss * 1024 / 1e6, written / 1e6)


def _figures(name: str, export: Export, recorded_s: float) -> Iterator[Figure]:
    note = (
        f"{export.wall_s:.1f} s, of them {export.cpu_s:.1f} s on a processor, "
        f"{export.written_mb:.0f} MB"
    )
    speed = recorded_s / export.wall_s
    yield Figure(f"{name}, of real time", speed, "x", _SPEEDS.get(name), note)
    yield Figure(f"{name}, memory", export.peak_mb, "MB", _MEMORY)
