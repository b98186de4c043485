"""Tables and texts: every sample once, and numbers that are read back as the same."""

from __future__ import annotations

import csv
import gzip
import io
import json
import math
import tempfile
from decimal import Decimal
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from biosensor_gateway.recording.contents.choice import Selection
from biosensor_gateway.recording.export.exporter import Clock
from biosensor_gateway.recording.export.job import Task, export
from biosensor_gateway.recording.export.outcome import sentences
from biosensor_gateway.recording.export.tables import numbers, rows_of_numbers
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from tests.recording_export.bids_shapes import SHAPES
from tests.recording_export.conftest import Exporting
from tests.recording_export.study import BEGIN_S, UNIX_NS, ecg_values, study
from tests.xdf import xdf_file as made
from tests.xdf.test_judging import acc, paused_recording

# Tables of comma-separated values: every sample once, and as it was.

_TEXT = st.text(st.characters(codec="utf-8", exclude_characters="\x00"), max_size=8)


def _rows(content: bytes) -> list[list[str]]:
    assert b"\r\n" not in content
    return list(csv.reader(io.StringIO(content.decode(), newline="")))


def _streams(folder: Path) -> list[dict[str, Any]]:
    return json.loads((folder / "streams.json").read_text("utf-8"))["streams"]


def test_each_stream_is_a_table(exported: Exporting) -> None:
    folder = exported(study(), "csv").written[0].path
    ecg, _, gsr, markers, _ = _streams(folder)
    assert ecg["columns"] == [
        {"name": "lsl_time", "unit": "s"},
        {"name": "seconds", "unit": "s"},
        {"name": "ECG", "label": "ECG", "unit": "microvolts"},
    ]
    assert (ecg["samples"], ecg["participant"], ecg["nominal_rate_hz"]) == (2600, "P1", 130)
    head, *rows = _rows((folder / ecg["file"]).read_bytes())
    assert head == ["lsl_time", "seconds", "ECG"]
    assert [float(row[1]) for row in rows[:2]] == [0.0, round(1 / 130, 6)]
    assert [np.float32(row[2]) for row in rows] == ecg_values(2600)[:, 0].tolist()
    assert float(rows[0][0]) == BEGIN_S
    assert _rows((folder / gsr["file"]).read_bytes())[8][2] == "NaN"
    marks = _rows((folder / markers["file"]).read_bytes())
    assert marks[2] == ["1012.0", "12.0", 'say "no",\nthen stop']


def test_the_time_of_day(exported: Exporting) -> None:
    folder = exported(study(), "csv", clock=Clock.WALL).written[0].path
    head, first, *_ = _rows((folder / _streams(folder)[0]["file"]).read_bytes())
    assert head[0] == "unix_time"
    assert float(first[0]) == UNIX_NS / 1e9


def test_one_person_alone(exported: Exporting) -> None:
    outcome = exported(study(), "csv-long", selection=Selection(participant="P2"))
    _, *rows = _rows(outcome.written[0].path.read_bytes())
    assert {row[1] for row in rows} == {"P2"}
    assert len(rows) == 80


def test_a_span_of_time(exported: Exporting) -> None:
    outcome = exported(
        study(), "csv-long", selection=Selection(streams=["*ecg"], begin="1", end="2.5")
    )
    _, *rows = _rows(outcome.written[0].path.read_bytes())
    assert len(rows) == 195
    assert min(float(row[0]) for row in rows) >= BEGIN_S + 1


def test_streams_of_one_name_have_tables_of_their_own(exported: Exporting) -> None:
    same = [made.stream_header(n, "a/b:c") + made.samples(n, "float32", [[n]], [n]) for n in (1, 2)]
    folder = exported(made.xdf(*same), "csv").written[0].path
    assert sorted(each.name for each in folder.iterdir()) == [
        "README.txt",
        "a_b_c.csv",
        "a_b_c_2.csv",
        "all_markers.csv",
        "streams.json",
    ]


@st.composite
def _recordings(draw: st.DrawFn) -> tuple[bytes, str, list[float], list[list[Any]]]:
    """One stream of any format in chunks of any size."""
    fmt = draw(st.sampled_from(["string", "int64", *made.DTYPES]))
    count, channels = draw(st.integers(1, 12)), draw(st.integers(1, 4))
    if fmt == "string":
        rows = draw(st.lists(st.lists(_TEXT, min_size=channels, max_size=channels), min_size=1))
    else:
        dtype = made.DTYPES.get(fmt, "<i8")
        rows = draw(arrays.arrays(dtype, (count, channels))).tolist()
    stamps = draw(
        st.lists(st.floats(-1e9, 1e9), min_size=len(rows), max_size=len(rows)),
    )
    cut = draw(st.integers(0, len(rows)))
    header = made.stream_header(1, "a", channels=channels, fmt=fmt)
    parts = (slice(0, cut), slice(cut, None))
    chunks = [_samples(fmt, rows[part], stamps[part]) for part in parts if stamps[part]]
    return made.xdf(header, *chunks), fmt, stamps, rows


def _samples(fmt: str, rows: list[list[Any]], stamps: list[float]) -> bytes:
    if fmt != "int64":
        return made.samples(1, fmt, rows, stamps)
    parts = [
        b"\x08" + np.array(stamp, "<f8").tobytes() + np.array(row, "<i8").tobytes()
        for row, stamp in zip(rows, stamps, strict=True)
    ]
    count = b"\x04" + len(rows).to_bytes(4, "little")
    return made.chunk(3, (1).to_bytes(4, "little") + count + b"".join(parts))


@settings(max_examples=60, deadline=None)
@given(_recordings(), st.booleans(), st.booleans())
def test_every_sample_is_read_back(
    made_of: tuple[bytes, str, list[float], list[list[Any]]], is_long: bool, is_packed: bool
) -> None:
    content, fmt, stamps, rows = made_of
    name = ("csv-long" if is_long else "csv") + (".gz" if is_packed else "")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "study.xdf")
        path.write_bytes(content)
        outcome = export(path, Task([name], Selection()), lambda _name, _s: lambda _done: None)
        target = outcome.written[0].path
        file = target if is_long else target / ("a.csv.gz" if is_packed else "a.csv")
        packed = file.read_bytes()
    _, *lines = _rows(gzip.decompress(packed) if is_packed else packed)
    width = len(rows[0])
    if is_long:
        times = [float(line[0]) for line in lines[::width]]
        column = 6 if fmt == "string" else 5
        cells = [line[column] for line in lines]
        read = [cells[at : at + width] for at in range(0, len(cells), width)]
    else:
        times, read = [float(line[0]) for line in lines], [line[2:] for line in lines]
    assert times == stamps
    if fmt == "string":
        assert read == rows
    else:
        dtype = np.dtype(made.DTYPES.get(fmt, "<i8"))
        again = [[dtype.type(text) for text in line] for line in read]
        np.testing.assert_array_equal(np.array(again), np.array(rows, dtype))


def test_all_that_happened_is_one_table_that_can_be_read(exported: Exporting) -> None:
    folder = exported(SHAPES["one person"], "csv").written[0].path
    head, *rows = _rows((folder / "all_markers.csv").read_bytes())
    assert head == ["seconds", "lsl_time", "marker", "note", "undone", "participant", "stream"]
    told = [(row[2], row[3], row[4]) for row in rows if not row[6].endswith("events")]
    # As typed, not as JSON has it.
    first, undone, noted = told[:3]
    assert (first, undone) == (("baseline", "", "no"), ("stimulus\ton", "", "yes"))
    assert noted == ("note", "Übelkeit?", "no")
    begin_s = float(rows[0][1]) - float(rows[0][0])
    assert f"The recording starts at {begin_s:.6f}" in (folder / "README.txt").read_text("utf-8")
    assert all(float(row[1]) - float(row[0]) == pytest.approx(begin_s) for row in rows)


def test_names_that_no_file_can_have_everywhere(exported: Exporting) -> None:
    names = ["AUX", "con", "nul.txt", "COM1", "-rf", "all_markers"]
    streams = [
        made.stream_header(n, name) + made.samples(n, "float32", [[n]], [n])
        for n, name in enumerate(names, 1)
    ]
    folder = exported(made.xdf(*streams), "csv").written[0].path
    assert [each["file"] for each in _streams(folder)] == [
        "AUX_.csv",
        "con_.csv",
        "nul_.txt.csv",
        "COM1_.csv",
        "rf.csv",
        "all_markers_2.csv",
    ]


def test_a_channel_that_is_called_like_a_column_of_times_gets_another_name(
    exported: Exporting,
) -> None:
    desc = ET.fromstring(
        "<desc><channels><channel><label>seconds</label></channel><channel><label>lsl_time"
        "</label></channel></channels></desc>"
    )
    header = made.stream_header(1, "a", channels=2, desc=desc)
    content = made.xdf(header, made.samples(1, "float32", [[1.0, 2.0]], [5.0]))
    folder = exported(content, "csv").written[0].path
    head, row = _rows((folder / "a.csv").read_bytes())
    assert head == ["lsl_time", "seconds", "seconds_2", "lsl_time_2"]
    assert row == ["5.0", "0.0", "1.0", "2.0"]


# Texts for Kubios and Ledalab.
@pytest.mark.parametrize(("name", "kind"), [("kubios", "RR"), ("ledalab", "GSR")])
def test_a_stream_that_is_called_as_the_readme_has_a_file_of_its_own(
    name: str, kind: str, exported: Exporting
) -> None:
    unit = {"RR": "s", "GSR": "microsiemens"}[kind]
    desc = ET.fromstring(
        f"<desc><channels><channel><label>x</label><unit>{unit}</unit></channel></channels></desc>"
    )
    content = made.xdf(
        made.stream_header(1, "README", kind=kind, rate=0.0, desc=desc),
        made.samples(1, "float32", [[0.75], [0.5]], [5.0, 6.0]),
    )
    folder = exported(content, name).written[0].path
    assert {each.name for each in folder.iterdir()} == {"README.txt", "README_2.txt"}
    assert "README_2.txt: " in (folder / "README.txt").read_text()
    assert b"0.75" in (folder / "README_2.txt").read_bytes()


def test_intervals_are_a_line_each(exported: Exporting) -> None:
    (written,) = exported(study(), "kubios").written
    intervals = (written.path / "P1-polar_h10-U1-ibi.txt").read_bytes()
    assert intervals == b"0.8\n" * 19
    assert "P1-polar_h10-U1-ibi: 1 samples are not intervals and are left out" in written.notes


def test_an_ecg_is_cut_at_its_gaps(exported: Exporting) -> None:
    (written,) = exported(study(), "kubios").written
    parts = [np.loadtxt(written.path / f"P1-polar_h10-U1-ecg_run{n}.txt") for n in (1, 2)]
    assert [len(each) for each in parts] == [1300, 1300]
    found = np.concatenate(parts).astype(np.float32)
    assert found.tolist() == ecg_values(2600)[:, 0].tolist()
    (rate,) = [each for each in written.notes if "tell Kubios" in each]
    assert "130 Hz" in rate
    assert "microvolts" in rate
    assert (
        "P1-polar_h10-U1-ecg: P1-polar_h10-U1-ecg_run1.txt begins at 0.000 s, "
        "P1-polar_h10-U1-ecg_run2.txt begins at 15.000 s"
    ) in written.notes


def test_missing_beats_are_said(exported: Exporting) -> None:
    stamps = [*(BEGIN_S + 0.8 * n for n in range(10)), *(BEGIN_S + 60 + 0.8 * n for n in range(9))]
    header = made.stream_header(1, "beats", kind="RR", desc=_unit("ms"))
    content = made.xdf(header, made.samples(1, "float32", [[800]] * 19, stamps))
    (written,) = exported(content, "kubios").written
    assert any(
        "beats are missing between the intervals, 52 s in total" in each for each in written.notes
    )
    assert (written.path / "beats.txt").read_bytes() == b"800.0\n" * 19


def test_conductance_has_its_markers(exported: Exporting) -> None:
    (written,) = exported(study(), "ledalab").written
    rows = np.loadtxt(written.path / "P2-empatica_e4-U1-gsr.txt")
    assert rows.shape == (79, 3)
    assert rows[rows[:, 2] > 0][:, [0, 2]].tolist() == [[1003.0, 1], [1012.0, 2]]
    codes = (written.path / "markers.csv").read_text()
    assert codes == '"code","marker"\n1,"go"\n2,"say ""no"",\nthen stop"\n'
    assert "P2-empatica_e4-U1-gsr: 1 samples have no value and are left out" in written.notes


@pytest.mark.parametrize(
    ("unit", "value", "expected"),
    [("kOhm", 250.0, 4.0), ("MOhm", 0.25, 4.0), ("uS", 4.0, 4.0), ("nS", 4000.0, 4.0)],
)
def test_skin_in_another_unit_is_turned_into_microsiemens(
    unit: str, value: float, expected: float, exported: Exporting
) -> None:
    header = made.stream_header(1, "skin", kind="GSR", rate=4.0, desc=_unit(unit))
    stamps = [BEGIN_S + n / 4 for n in range(40)]
    content = made.xdf(header, made.samples(1, "float32", [[value]] * 39 + [[0.0]], stamps))
    (written,) = exported(content, "ledalab").written
    rows = np.loadtxt(written.path / "skin.txt")
    assert rows[:39, 1] == pytest.approx(expected)
    # A resistance of nothing is no value.
    assert len(rows) == (39 if "Ohm" in unit else 40)
    assert any("converted" in each for each in written.notes) == (unit != "uS")


def test_why_nothing_can_be_read_is_said(exported: Exporting) -> None:
    broken = made.stream_header(1, "skin", kind="GSR", rate=4.0).replace(b">4.0<", b">4,0<")
    content = made.xdf(broken, made.samples(1, "float32", [[1.0]], [BEGIN_S]))
    with pytest.raises(RecordingError, match=r"nominal rate.*salvage") as caught:
        exported(content, "csv")
    assert caught.value.reason is RecordingReason.EMPTY


@pytest.mark.parametrize("name", ["kubios", "ledalab", "edf"])
def test_a_format_without_anything_for_it_is_one_sentence(name: str, exported: Exporting) -> None:
    with pytest.raises(RecordingError, match="nothing was written") as caught:
        exported(study(), name, selection=Selection(streams=["*markers"]))
    assert caught.value.reason is RecordingReason.EMPTY
    assert "\n" not in str(caught.value)


def _unit(unit: str) -> ET.Element:
    desc = ET.Element("desc")
    channel = ET.SubElement(ET.SubElement(desc, "channels"), "channel")
    ET.SubElement(channel, "label").text = "RR"
    ET.SubElement(channel, "unit").text = unit
    return desc


# Text of numbers: the shortest that is read back as the same number.
FORMATS = ("<f4", "<f8", "<i8", "<i4", "<i2", "i1")


@given(st.sampled_from(FORMATS), st.data())
def test_every_number_is_read_back_as_it_was(dtype: str, data: st.DataObject) -> None:
    shape = st.tuples(st.integers(1, 5), st.integers(1, 4))
    values = data.draw(arrays.arrays(dtype, shape))
    times = data.draw(arrays.arrays("<f8", len(values), elements=st.floats(0, 1e12)))
    lines = rows_of_numbers(times, values).decode().splitlines()
    rows = [line.split(",") for line in lines]
    read = np.dtype(dtype).type
    again = [[read(text) for text in row[1:]] for row in rows]
    np.testing.assert_array_equal(np.array(again, dtype), values)
    assert [float(row[0]) for row in rows] == times.tolist()
    assert [text.decode() for text in numbers(values)] == [text for row in rows for text in row[1:]]


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_a_short_decimal_stays_short(value: float) -> None:
    (text,) = numbers(np.array([value], np.float32))
    assert np.float32(text.decode()) == np.float32(value)
    if value == 0 or 1e-12 < abs(value) < 1e12:
        assert _digits(text.decode()) <= _digits(str(np.float32(value)))


def _digits(text: str) -> int:
    return len(Decimal(text).normalize().as_tuple().digits)


def test_what_is_no_number_can_be_told_apart() -> None:
    values = np.array([[math.nan, math.inf, -math.inf, -0.0]], np.float32)
    assert rows_of_numbers(np.array([0.5]), values) == b"0.5,NaN,inf,-inf,-0.0\n"


def test_integers_of_64_bits_lose_nothing() -> None:
    values = np.array([[2**63 - 1, -(2**63)]])
    assert rows_of_numbers(np.array([1.0]), values) == (
        b"1.0,9223372036854775807,-9223372036854775808\n"
    )


def test_data_of_another_agent_are_told_and_not_well(exported: Exporting) -> None:
    beats = [[1003.0, 900.0], [1008.0, 900.0], [1012.0, 950.0]]
    texts = [
        {"event": "heartbeat", "lsl_time": at, "agent_started": started} for at, started in beats
    ]
    outcome = exported(paused_recording(*acc(1000, 1020), more=texts), "csv")
    assert not outcome.is_whole
    (told,) = (each for each in sentences(outcome) if "another agent" in each)
    assert told.startswith("gateway-lab_x2Dpc-events: from 12.0 s on it belongs to another agent")
    (readme,) = outcome.written[0].path.rglob("README.txt")
    assert "another person's" in " ".join(readme.read_text().split())


def test_a_time_that_no_float_holds_is_that_of_the_sample(exported: Exporting) -> None:
    odd = {"event": "off_body", "lsl_time": 10**400}
    folder = exported(paused_recording(*acc(1000, 1020), more=[odd]), "csv").written[0].path
    rows = _rows((folder / "all_markers.csv").read_bytes())
    assert [float(row[1]) for row in rows if row[2] == "off_body"] == [1004.0]


def test_a_pause_is_told_where_gaps_are(exported: Exporting) -> None:
    outcome = exported(paused_recording(*acc(1000, 1005), *acc(1009, 1020)), "csv")
    told = "polar_h10/A1 of P01 was paused from 5.0 s to 8.0 s: data missing then was not sent"
    (readme,) = outcome.written[0].path.rglob("README.txt")
    assert told in " ".join(readme.read_text().split())


@pytest.mark.parametrize("away_s", [1e308, -1e308, 1e18])
def test_a_marker_of_any_time_is_in_the_table_of_markers(away_s: float, tmp_path: Path) -> None:
    stamps = (1000.0 + np.arange(260) / 130).tolist()
    path = tmp_path / "study.xdf"
    told = [["near"], ["far"]] if away_s > 0 else [["far"], ["near"]]
    moments = sorted([1001.0, away_s])
    path.write_bytes(
        made.xdf(
            *made.regular(1, "ecg", stamps, 130.0),
            made.stream_header(2, "events", kind="Markers", fmt="string"),
            made.samples(2, "string", told, moments),
        )
    )
    task = Task(["csv"], Selection(), is_wide=True)
    outcome = export(path, task, lambda _name, _s: lambda _done: None)
    tables = list(outcome.written[0].path.glob("all_130*.csv"))
    # Rows would be counted from the first of all times.
    assert bool(tables) == (away_s > 0)
    assert not tables or '"near"' in tables[0].read_text()
    assert outcome.is_whole == (away_s > 0) or outcome.clock_notes
    rows = (outcome.written[0].path / "all_markers.csv").read_text()
    assert '"near"' in rows and '"far"' in rows
