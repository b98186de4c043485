"""A recording, from its bytes to what is exported of it.

Whatever the recording is, each format is written or refused with a GatewayError of one line;
tables hold every sample that can be read and has a time, and nothing half-made is left behind.
"""

from __future__ import annotations

import csv
import io
import os
import shutil
from pathlib import Path
from unittest.mock import patch

from biosensor_common.errors import GatewayError
from biosensor_gateway.recording.contents.choice import Selection
from biosensor_gateway.recording.contents.contents import open_contents
from biosensor_gateway.recording.export.job import Task, export
from biosensor_gateway.recording.export.outcome import Outcome
from biosensor_gateway.recording.export.readme import OF_ONE_FILE, readme_beside
from biosensor_gateway.recording.export.tables import MARKERS
from tests.fuzz.contract import ensure
from tests.fuzz.scratch import folder, written

_PACKED = b"\x1f\x8b"
_MOST_PACKED = 1024
_BATCH = 4
"""So many values at once, for what is fuzzed is small, and batches and sections are to fill."""
_FORMATS = ("csv", "csv-long", "edf", "kubios", "ledalab", "bids", "mcap")


def check(data: bytes) -> None:
    """Export the recording in one format after the other."""
    # A file may hold a thousand times its size when it is unpacked, which is no find.
    if data.startswith(_PACKED) and len(data) > _MOST_PACKED:
        return
    path, target = written("study.xdf", data), folder() / "exported"
    for name in _FORMATS:
        shutil.rmtree(target, ignore_errors=True)
        target.mkdir()
        try:
            # What it writes need not outlive the power.
            with patch.object(os, "fsync"):
                task = Task([name], Selection(), output=target, batch=_BATCH)
                outcome = export(path, task, lambda _f, _s: _ignore)
        except GatewayError as error:
            ensure(str(error) != "" and "\n" not in str(error), "a refusal of no line", error)
            ensure(not any(target.iterdir()), "a refused export is left behind", name)
            continue
        made = {each.path for each in outcome.written}
        made |= {readme_beside(each) for each in made if name in OF_ONE_FILE}
        ensure(set(target.iterdir()) == made, "something else is left behind", made)
        if name == "csv":
            _holds_all(outcome, path)


def _ignore(_done: float) -> None:
    pass


def _holds_all(outcome: Outcome, path: Path) -> None:
    with open_contents(path) as contents:
        counts = [sum(map(len, each.blocks())) for each in contents.streams]
    made = outcome.written[0].path.glob("*.csv")
    tables = sorted(each for each in made if each.name != MARKERS)
    ensure(len(tables) == len(counts), "not every stream is a table", len(tables), len(counts))
    # Line ends in texts are in quotes.
    csv.field_size_limit(1 << 30)
    rows = [_rows(table.read_text("utf-8")) for table in tables]
    ensure(sorted(rows) == sorted(counts), "tables of other samples", rows, counts)


def _rows(text: str) -> int:
    return sum(1 for _ in csv.reader(io.StringIO(text.replace("\0", ""), newline=""))) - 1
