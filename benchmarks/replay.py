"""What it takes to play a recording, and how late its samples are."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import pylsl

from benchmarks import long_recording
from benchmarks.effort import Effort
from benchmarks.figures import Figure, Measurement, Target
from benchmarks.processes import BenchError

STREAMS = 64
SPEEDS = (1.0, 10.0)
_RATES_HZ = (4.0, 10.0, 25.0, 32.0, 50.0, 64.0, 130.0, 250.0)
_CPU, _LATE, _KEEPS_UP = Target(20), Target(5), Target(1.05)


def measure(effort: Effort) -> Measurement:
    """Play 64 streams, each with a receiver, at the speed of life and at ten times that.

    Raises
    ------
    BenchError
        If it cannot be played.
    """
    rates = [_RATES_HZ[at % len(_RATES_HZ)] for at in range(STREAMS)]
    played: dict[float, Mapping[str, float]] = {}
    with tempfile.TemporaryDirectory() as name:
        for speed in SPEEDS:
            recording = Path(name, f"study_{speed:.0f}.xdf")
            long_recording.write(
                recording, effort.sixteen_s * speed, long_recording.of_signals(rates)
            )
            played[speed] = _play(recording, speed)
    figures = [
        figure
        for speed, each in played.items()
        for figure in _figures(speed, each, effort.sixteen_s)
    ]
    title = f"replay of {STREAMS} streams, {sum(rates):.0f} samples a second"
    return Measurement(
        title, figures, {f"{speed:.0f}": dict(each) for speed, each in played.items()}
    )


def _play(recording: Path, speed: float) -> Mapping[str, float]:
    with subprocess.Popen(
        [sys.executable, "-m", "benchmarks.replay_role", str(recording), str(speed)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        if process.stdout.readline().strip() != "offered":
            raise BenchError(f"{recording.name} is not played")
        found = pylsl.resolve_byprop("type", "EEG", STREAMS, 30.0)
        if len(found) < STREAMS:
            raise BenchError(f"only {len(found)} of {STREAMS} streams are found")
        inlets = [pylsl.StreamInlet(each) for each in found]
        for inlet in inlets:
            inlet.open_stream(30.0)
        process.stdin.write("play\n")
        process.stdin.flush()
        said = process.stdout.readline()
        del inlets
    if process.returncode:
        raise BenchError(f"playing {recording.name} failed")
    return json.loads(said)


def _figures(speed: float, played: Mapping[str, float], wanted_s: float) -> Iterator[Figure]:
    at = f"at {speed:.0f} x"
    share = 100 * played["cpu_s"] / played["wall_s"]
    late = f"median {played['p50']:.1f} ms, {played['sent']:.0f} samples"
    yield Figure(f"CPU {at}", share, "%", _CPU if speed == 1 else None, "of one core")
    yield Figure(
        f"samples late {at}, p99", played["p99"], "ms", _LATE if speed == 1 else None, late
    )
    # It waits a second at the end until LSL has sent everything.
    yield Figure(
        f"time taken {at}", (played["wall_s"] - 1.0) / wanted_s, "", _KEEPS_UP, "of its own"
    )
