"""Reads, judges and salvages the bytes of a file in one step."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, cast

import pyxdf

from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.recording import Recording, read_recording
from biosensor_gateway.recording.xdf.report import Measured, Report
from biosensor_gateway.recording.xdf.salvage.outcome import Outcome, salvage, salvaged_path
from biosensor_gateway.recording.xdf.verdict import ExpectedStream, judge

# Reads and judges the bytes of a file in one step.


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


# Salvages the bytes of a file, and reads what comes of it with pyxdf.
Rows = list[tuple[float, tuple[Any, ...]]]
"""Stamp and values of each sample."""


class Salvaged(NamedTuple):
    outcome: Outcome
    file: Path
    content: bytes


def salvaged(content: bytes, folder: Path, name: str = "study.xdf") -> Salvaged:
    """Salvage a recording that is not whole, and see that it and its result are as they should be.

    The recording is as it was, nothing else is in the folder but the result, and that is whole.
    """
    path = folder / name
    path.write_bytes(content)
    target = salvaged_path(path)
    outcome = salvage(path, target)
    assert outcome.written == target
    assert path.read_bytes() == content
    assert sorted(each.name for each in folder.iterdir()) == sorted([name, target.name])
    recording = read_recording(target)
    assert not recording.damages
    assert not recording.orphans
    assert salvage(target, folder / "again.xdf").written is None
    assert not codes(judge(recording), Level.ERROR)
    return Salvaged(outcome, target, target.read_bytes())


def rows(path: Path) -> dict[str, Rows]:
    """Return the samples of each stream, as pyxdf reads them."""
    return {
        stream["info"]["name"][0]: [
            (float(stamp), tuple(value))
            for stamp, value in zip(stream["time_stamps"], stream["time_series"], strict=True)
        ]
        for stream in load_by_pyxdf(path)
    }
