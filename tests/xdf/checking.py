"""Reads and judges the bytes of a file in one step."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import pyxdf

from biosensor_gateway.recording.xdf.expectation import ExpectedStream
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.judging import judge
from biosensor_gateway.recording.xdf.recording import Recording, read_recording
from biosensor_gateway.recording.xdf.report import Measured, Report


def read(content: bytes, name: str = "study.xdf") -> Recording:
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(content)
        return read_recording(path)


def check(content: bytes, *expected: ExpectedStream) -> Report:
    return judge(read(content), expected)


def codes(report: Report, level: Level | None = None) -> set[tuple[str, str]]:
    """Return (code, stream) of the findings, of one level or of all."""
    return {(f.code, f.stream) for f in report.findings if level in (None, f.level)}


def text_of(report: Report, code: str, stream: str = "") -> str:
    (text,) = (f.text for f in report.findings if (f.code, f.stream) == (code, stream))
    return text


def only(report: Report) -> Measured:
    (measured,) = report.streams
    return measured


def load_by_pyxdf(path: Path) -> list[dict[str, Any]]:
    """Load a file with its stamps as they are."""
    load = cast("Any", pyxdf).load_xdf
    streams, _ = load(str(path), synchronize_clocks=False, dejitter_timestamps=False)
    return streams
