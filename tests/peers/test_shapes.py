"""What is exported of odd recordings opens in the programs of others, and is what was recorded."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from biosensor_gateway.recording.bag.conversion import import_bag
from biosensor_gateway.recording.contents.choice import Selection
from biosensor_gateway.recording.contents.contents import open_contents
from biosensor_gateway.recording.export.job import Task, export
from biosensor_gateway.recording.xdf.container import RecordingError
from tests.peers.test_peers import ENVIRONMENT, PEERS
from tests.recording_export import odd_shapes

# All are read by one process, and the first test waits for it.
pytestmark = [pytest.mark.nightly, pytest.mark.timeout(1200)]

FORMATS = ("csv", "csv-long.gz", "edf", "kubios", "ledalab", "bids", "mcap")
DEADLINE_S = 900.0
FILES = odd_shapes.files()
MOST = 1e290
"""Larger values have no sum."""
# pyxdf needs a name of each stream, also in the recording itself.
NAMELESS = {"odd names", "a stream without a name"}

# Volts are written as microvolts.
IN_VOLTS = {"odd names"}

Read = dict[str, dict[str, Any]]


@dataclass
class Exported:
    """What is in a recording, what its exports said, and what others read of them."""

    notes: str
    lacking: set[str] = field(default_factory=set[str])
    """Formats that say that they lack something."""
    counts: list[int] = field(default_factory=list[int])
    sums: list[list[float]] = field(default_factory=list[list[float]])
    kinds: list[str] = field(default_factory=list[str])
    """Type of each of these streams; empty for markers."""
    marked: int = 0
    """Samples of markers that are numbers, which are annotations in EDF."""
    markers: list[str] = field(default_factory=list[str])
    files: Read = field(default_factory=dict[str, dict[str, Any]])

    def of(self, begin: str) -> list[dict[str, Any]]:
        """Return what was read of the files whose path begins so."""
        return [read for file, read in self.files.items() if file.startswith(begin)]


def _export(shape: str, folder: Path) -> Exported | None:
    """Export a recording to all formats; None if nothing can be."""
    name, data = FILES[shape]
    folder.mkdir()
    path = folder / name.replace(Path(name).name.partition(".")[0], "rec")
    path.write_bytes(data)
    try:
        outcome = export(path, Task(FORMATS, Selection()), lambda _n, _s: lambda _done: None)
    except RecordingError:
        path.unlink()
        return None
    notes = [note for each in outcome.written for note in each.notes]
    notes += [each.why for each in outcome.without]
    found = Exported(" ".join([*notes, *outcome.clock_notes]))
    found.lacking = {each.format for each in outcome.without}
    found.lacking |= {each.format for each in outcome.written if not each.is_whole}
    with open_contents(path) as contents:
        for stream in contents.streams:
            blocks = list(stream.blocks())
            count = sum(map(len, blocks))
            if stream.header.is_markers:
                found.markers += [
                    str(value) for block in blocks for row in block.values for value in row
                ]
            if count and not isinstance(blocks[0].values, list):
                values = np.concatenate([np.asarray(block.values, float) for block in blocks])
                finite = np.where(np.abs(values) < MOST, values, 0.0)
                found.counts.append(count)
                found.marked += count * stream.header.is_markers
                found.sums.append(finite.sum(axis=0).tolist())
                is_markers = stream.header.is_markers
                found.kinds.append("" if is_markers else str(stream.header.content_type))
    import_bag(folder / "rec_bag", folder / "again.xdf")
    path.unlink()
    return found


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Exported]:
    """All shapes in all formats, as others read them; by one process, for it loads a lot."""
    # A skip would pass where nothing was tried.
    if not (ENVIRONMENT / ".installed").exists():
        pytest.fail("the peers are not installed: run `make venv-peers` first")
    root = tmp_path_factory.mktemp("shapes")
    made = {shape: _export(shape, root / f"{at:03}") for at, shape in enumerate(FILES)}
    done = subprocess.run(
        [ENVIRONMENT / "bin/python", PEERS / "shapes_read.py", *sorted(root.iterdir())],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    read: dict[str, Read] = json.loads(done.stdout)
    found: dict[str, Exported] = {}
    for at, (shape, each) in enumerate(made.items()):
        if each is not None:
            each.files = read[str(root / f"{at:03}")]
            found[shape] = each
    return found


def test_each_file_opens(exported: dict[str, Exported]) -> None:
    failed = {
        (shape, file): read["error"]
        for shape, each in exported.items()
        for file, read in each.files.items()
        if "error" in read and not (shape in NAMELESS and file == "again.xdf")
    }
    assert failed == {}
    assert len(exported) > 70
    assert sum(len(each.files) for each in exported.values()) > 1000


def test_a_table_has_each_value(exported: dict[str, Exported]) -> None:
    for shape, each in exported.items():
        tables = [read for read in each.of("rec_csv/") if read["sums"]]
        # A stream that was cut has tables of one number of columns, in any order.
        assert sum(read["count"] for read in tables) == sum(each.counts), shape
        _same_sums(shape, [read["sums"] for read in tables], each.sums, 1e-6)


def test_a_bag_has_each_sample(exported: dict[str, Exported]) -> None:
    for shape, each in exported.items():
        ((bag,), (again,)) = (each.of("rec_bag/"), each.of("again.xdf"))
        assert bag["count"] == sum(each.counts) or "left out" in each.notes, shape
        if "error" not in again:
            assert again["count"] >= bag["count"], shape


def test_signals_have_each_value_or_it_is_said(exported: dict[str, Exported]) -> None:
    for shape, each in exported.items():
        bdf = each.of("rec_edf/")
        if not bdf or any(told in each.notes for told in ("left out", "no rate", "without")):
            assert each.notes, shape
            continue
        assert sum(read["count"] for read in bdf) >= sum(each.counts) - each.marked, shape
        if shape not in IN_VOLTS and sum(read["count"] for read in bdf) == sum(each.counts):
            # Of 24 bits, each value is half a step off at most.
            _same_sums(shape, [read["sums"] for read in bdf], each.sums, 1e-3, 0.05)


def test_a_data_set_has_each_value(exported: dict[str, Exported]) -> None:
    for shape, each in exported.items():
        tables = [read for read in each.of("rec_bids/") if read["sums"]]
        due = [all_ for all_, kind in zip(each.sums, each.kinds, strict=True) if kind]
        if "bids" in each.lacking:
            continue
        assert bool(tables) == bool(due), shape
        if shape not in IN_VOLTS:
            _same_sums(shape, [read["sums"] for read in tables], due, 1e-3, 0.05)


def test_kubios_has_each_value(exported: dict[str, Exported]) -> None:
    for shape, each in exported.items():
        files = [read for read in each.of("rec_kubios/") if read["sums"]]
        streams = zip(each.sums, each.kinds, strict=True)
        due = [all_ for all_, kind in streams if kind in ("ECG", "RR")]
        if "kubios" in each.lacking:
            continue
        assert bool(files) == bool(due), shape
        _same_sums(shape, [read["sums"] for read in files], due, 1e-6)


def test_each_marker_is_in_each_format(exported: dict[str, Exported]) -> None:
    for shape, each in exported.items():
        due = {_bare(text) for text in each.markers} - {""}
        for begin in ("rec_csv/all_markers", "rec_edf/", "rec_bids/", "rec_bag/"):
            files = each.of(begin)
            read = {_bare(text) for file in files for text in file["markers"]}
            if files and begin != "rec_bag/":
                assert due <= read or "shortened" in each.notes, (shape, begin, due - read)


def _bare(text: str) -> str:
    """Return a marker without what no format has in the same way: line ends, controls, length."""
    return "".join(char for char in text if char.isprintable() and not char.isspace())[:30]


def _same_sums(
    shape: str,
    read: Sequence[list[float]],
    due: Sequence[list[float]],
    relative: float,
    most: float = 1e-3,
) -> None:
    flat = [sorted(value for each in all_ for value in each) for all_ in (read, due)]
    if len(flat[0]) == len(flat[1]):
        assert flat[0] == pytest.approx(flat[1], rel=relative, abs=most), shape
    else:
        assert sum(flat[0]) == pytest.approx(sum(flat[1]), rel=relative, abs=most), shape
