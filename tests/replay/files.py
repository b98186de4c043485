"""Recordings to play, made byte by byte."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from tests.xdf import xdf_file as made

BEGIN_S = 5000.0
TEXTS = ["plain", "ünï \N{GRINNING FACE}", "a\0b", "", "line\nline", "&<>\"'"]
# A factor of an attribute, and a text beside elements: LSL's own tools write neither.
STRANGE = ET.fromstring(
    '<desc kind="odd"><setup by="me">said <who>P1</who></setup><n>ünï</n></desc>'
)


def write(path: Path, *streams: bytes) -> Path:
    path.write_bytes(made.xdf(*streams))
    return path


def regular(
    number: int,
    name: str,
    rate: float,
    seconds: float,
    *,
    fmt: str = "float32",
    begin_s: float = 0.0,
    gap: tuple[float, float] | None = None,
    offset_s: float = 0.0,
    **header: Any,
) -> bytes:
    """Two channels in chunks of half a second, with jitter that no player may remove.

    Parameters
    ----------
    begin_s
        After `BEGIN_S`.
    gap
        Seconds since `begin_s` in which nothing is.
    offset_s
        What to add to its stamps for the recorder's clock.
    """
    draw = np.random.default_rng(number)
    times = np.arange(0.0, seconds, 1 / rate)
    times = times[~((times > gap[0]) & (times < gap[1]))] if gap else times
    times = BEGIN_S + begin_s + times + draw.uniform(0, 0.2 / rate, len(times))
    values = draw.uniform(-127, 127, (len(times), 2))
    stamps = times - offset_s
    parts = [made.stream_header(number, name, channels=2, rate=rate, fmt=fmt, **header)]
    step = max(1, round(rate / 2))
    parts += [
        made.samples(number, fmt, values[at : at + step].tolist(), stamps[at : at + step].tolist())
        for at in range(0, len(times), step)
    ]
    return b"".join(parts) + (made.offsets(number, stamps[::step], offset_s) if offset_s else b"")


def texts(number: int, name: str, times: list[float], **header: Any) -> bytes:
    said = [[TEXTS[n % len(TEXTS)], str(n)] for n in range(len(times))]
    stamps = [BEGIN_S + each for each in times]
    head = made.stream_header(number, name, kind="Markers", fmt="string", channels=2, **header)
    return head + made.samples(number, "string", said, stamps)


# The command as a process of its own.

PATIENCE_S = 60.0


class Playing:
    """A replay that runs; `said` is complete once it has ended."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.said = ""

    def ended(self) -> int:
        """Wait for the end; return the exit code."""
        rest, _ = self._process.communicate(timeout=PATIENCE_S)
        self.said += rest
        return self._process.returncode

    def interrupt(self) -> int:
        """Press Ctrl-C; return the exit code."""
        self._process.send_signal(signal.SIGINT)
        return self.ended()

    def begun(self) -> str:
        """Wait until the streams are on the network; return the sentence that says so."""
        assert self._process.stdout is not None
        self.said += self._process.stdout.readline()
        return self.said


@contextmanager
def playing(file: Path, *options: str) -> Generator[Playing]:
    command = [sys.executable, "-m", "biosensor_gateway.cli", "replay", str(file), *options]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, encoding="utf-8"
    )
    try:
        yield Playing(process)
    finally:
        process.kill()
        process.communicate()
