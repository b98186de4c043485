"""Salvages the bytes of a file, and reads what comes of it with pyxdf."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.judging import judge
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.recording.xdf.salvage.outcome import Outcome, salvage, salvaged_path
from tests.xdf.checking import codes, load_by_pyxdf

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
