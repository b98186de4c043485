"""Writes EEG for BIDS: BrainVision files in ``eeg``, with their channels and events.

Samples are placed on an evenly spaced grid. After a short gap the file continues, with NaN in the
gap and an event ``BAD_gap``, which MNE excludes; a long gap starts a new run.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export.bids import sidecars
from biosensor_gateway.recording.export.bids.brain_vision import (
    BinaryRows,
    is_small,
    write_header,
)
from biosensor_gateway.recording.export.bids.file_names import Entities
from biosensor_gateway.recording.export.bids.regular import RegularTable, fill
from biosensor_gateway.recording.export.bids.run_file import RunFile
from biosensor_gateway.recording.export.bids.tables import NOTHING, write_json
from biosensor_gateway.recording.export.timeline import Timeline
from biosensor_gateway.recording.export.timing import Part, Timing

_EEG = "eeg"
_COUNTED = {
    "EEG": "EEG",
    "EOG": "EOG",
    "ECG": "ECG",
    "EMG": "EMG",
    "MISC": "Misc",
    "TRIG": "Trigger",
}


def write_eeg(
    root: Path,
    stream: Stream,
    entities: Entities,
    samples: Iterator[Samples],
    part: Part,
    rate_hz: float,
) -> tuple[RunFile, RegularTable]:
    """Write samples and header of one run.

    Parameters
    ----------
    samples
        Samples of the run, with times in seconds since zero.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    path = root / entities.path(_EEG, "eeg.eeg")
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("x+b") as file:
        rows = BinaryRows(file, is_small=is_small(stream))
        grid = fill(rows, samples, part, rate_hz)
    write_header(path.with_suffix(".vhdr"), stream, names_of(stream), rows.kind, rate_hz)
    start_s = part.start_s + grid.first_row / rate_hz
    table = RegularTable(
        path,
        start_s,
        grid.samples,
        rows.rows - grid.samples,
        grid.displacement.largest / rate_hz,
        grid.displacement.moved,
    )
    file = RunFile(_EEG, stream, entities, "", start_s, rate_hz, rows.rows, tuple(rows.empty))
    return file, table


def names_of(stream: Stream) -> list[str]:
    """Return the names of the channels."""
    return sidecars.columns(stream)


def describe(
    root: Path, file: RunFile, timing: Timing, table: RegularTable, timeline: Timeline
) -> None:
    """Write the sidecar files of a run, except its events."""
    stream = file.stream
    units = [sidecars.unit(each) for each in stream.meaning.units]
    types = file.write_channels(root, names_of(stream), units)
    counts = {f"{name}ChannelCount": types.count(kind) for kind, name in _COUNTED.items()}
    content = {
        **file.described(),
        "EEGReference": NOTHING,
        **counts,
        **sidecars.of_grid(stream, timing, table),
        **sidecars.of_stream(stream, timeline),
    }
    write_json(root / file.path("eeg.json"), content)
