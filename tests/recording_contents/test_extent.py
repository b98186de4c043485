"""All that is made of a recording counts its seconds from where `xdf check` does."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.recording.contents.choice import Selection, choose
from biosensor_gateway.recording.contents.contents import open_contents
from biosensor_gateway.recording.export.job import Task, export
from biosensor_gateway.recording.export.readme import README
from biosensor_gateway.recording.replay.player import Player, PlayOptions, ReplayError
from biosensor_gateway.recording.xdf.container import RecordingError
from tests.recording_export import bids_shapes, odd_shapes
from tests.recording_export.test_one_notion import SHAPES
from tests.xdf import xdf_file as made
from tests.xdf.checking import check

BEGIN_S, RATE = bids_shapes.BEGIN_S, 130.0
STRAP = DeviceIdentity("polar_verity_sense", "A1", "P01")
AGENT = DeviceIdentity("gateway", "lab-pc")


def _signal(begin_s: float = BEGIN_S, count: int = 1300) -> bytes:
    stamps = bids_shapes.times(count, RATE, begin_s)
    values = bids_shapes.numbers(count)
    return bids_shapes.ours(1, STRAP, "ppg", values, stamps, rate=RATE, kind="PPG")


def _intervals(begin_s: float, count: int) -> bytes:
    stamps, values = bids_shapes.times(count, 1.0, begin_s), bids_shapes.numbers(count)
    return bids_shapes.ours(2, STRAP, "ibi", values, stamps, [("RR", "s")], kind="RR")


def _battery(at_s: float) -> bytes:
    told = [("battery", "percent")]
    return bids_shapes.ours(3, STRAP, "bat", [[90.0]], [at_s], told, kind="Battery")


def _own_marker(at_s: float) -> bytes:
    mark = bids_shapes.marker(1, "baseline", at_s)
    return bids_shapes.ours(4, AGENT, "markers", [mark], [at_s], fmt="string", kind="Markers")


def _other_marker(at_s: float) -> bytes:
    return bids_shapes.stream(5, "PsychoPy", [["go"]], [at_s], fmt="string", kind="Markers")


def _drifting() -> bytes:
    """An hour of a computer whose clock runs 100 ppm fast, seen from the recorder."""
    stamps = BEGIN_S + np.arange(3600.0)
    header = made.stream_header(6, "skin", kind="GSR", rate=1.0, source_id="id6")
    asked = [(float(at), -1e-4 * float(at - BEGIN_S)) for at in stamps[::5]]
    return b"".join(
        (
            header,
            made.samples(6, "float32", [[2.0]] * len(stamps), stamps.tolist()),
            *(made.clock_offset(6, *each) for each in asked),
            made.footer(6, len(stamps)),
        )
    )


OWN: dict[str, list[bytes]] = {
    "intervals of before": [_signal(), _intervals(BEGIN_S - 20.0, 30)],
    "intervals alone": [_intervals(BEGIN_S - 20.0, 30)],
    "a battery of hours ago": [_signal(), _battery(BEGIN_S - 4000.0)],
    "a battery alone": [_battery(BEGIN_S - 4000.0)],
    "our marker before": [_signal(), _own_marker(BEGIN_S - 5.0)],
    "another program's marker before": [_signal(), _other_marker(BEGIN_S - 5.0)],
    "another program's marker after": [_signal(), _other_marker(BEGIN_S + 40.0)],
    "a recorder that went on": [_signal(), made.offsets(1, (BEGIN_S + 20, BEGIN_S + 44))],
    "a fast clock": [_drifting()],
}
CORPUS: dict[str, Callable[[], bytes]] = {
    **{name: lambda parts=parts: made.xdf(*parts) for name, parts in {**SHAPES, **OWN}.items()},
    **{f"odd: {name}": lambda name=name: odd_shapes.content(name) for name in odd_shapes.SHAPES},
}


@pytest.mark.parametrize("shape", CORPUS)
def test_check_contents_and_replay_have_one_begin_and_one_end(shape: str, tmp_path: Path) -> None:
    path = tmp_path / "rec.xdf"
    path.write_bytes(CORPUS[shape]())
    judged = check(path.read_bytes()).extent
    with open_contents(path) as contents:
        assert contents.begin_s == pytest.approx(judged.begin, abs=1e-6)
        assert contents.end_s == pytest.approx(judged.end, abs=1e-6)
        if any(each.clock_error for each in contents.streams):
            return  # it is not played with the others
        try:
            player = Player(choose(contents, Selection()), PlayOptions(), "hash")
        except ReplayError:
            return
        assert player.begin_s == pytest.approx(judged.begin, abs=1e-6)
        assert player.end_s == pytest.approx(judged.end, abs=1e-6)


@pytest.mark.parametrize("shape", OWN)
def test_a_table_and_its_readme_count_from_the_begin_of_check(shape: str, tmp_path: Path) -> None:
    path = tmp_path / "rec.xdf"
    path.write_bytes(made.xdf(*OWN[shape]))
    begin_s = check(path.read_bytes()).extent.begin
    try:
        outcome = export(path, Task(["csv"], Selection()), lambda _name, _s: lambda _done: None)
    except RecordingError:
        pytest.fail("nothing was exported")
    folder = outcome.written[0].path
    for table in folder.glob("*.csv"):
        with table.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                own_s, since_s = (float(row[each]) for each in ("lsl_time", "seconds"))
                assert own_s - since_s == pytest.approx(begin_s, abs=2e-6)
    told = " ".join((folder / README).read_text(encoding="utf-8").split())
    assert f"The recording starts at {begin_s:.6f}" in told
    assert "can have negative seconds" in told
