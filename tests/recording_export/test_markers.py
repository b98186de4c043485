"""Markers of any kind are the same in all formats, and none is lost unsaid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from edfio import read_bdf
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.recording.export.edf.exporter import Span, dealt_to_spans
from biosensor_gateway.recording.export.outcome import Outcome
from tests.recording_export.bids_shapes import read
from tests.recording_export.conftest import Exporting
from tests.recording_export.study import BEGIN_S
from tests.xdf import xdf_file as made

RATE = 10.0
KINDS = [
    ("Markers", "string"),
    ("markers", "string"),
    ("Marker", "string"),
    ("Trigger", "string"),
    ("StringMarker", "string"),
    ("BCI", "string"),
    ("Markers", "int32"),
    ("trigger", "float32"),
    ("Stim", "int16"),
]


def _skin(*spans: tuple[float, float]) -> bytes:
    """Conductance in these spans of seconds since the begin."""
    stamps = np.concatenate([np.arange(begin, end, 1 / RATE) for begin, end in spans]) + BEGIN_S
    values = np.full((len(stamps), 1), 2.0)
    header = made.stream_header(1, "skin", kind="GSR", rate=RATE)
    return header + made.samples(1, "float32", values.tolist(), stamps.tolist())


def _markers(number: int, kind: str, fmt: str, told: dict[float, str]) -> bytes:
    values = [[text] if fmt == "string" else [float(text)] for text in told.values()]
    header = made.stream_header(number, f"told {number}", kind=kind, fmt=fmt)
    return header + made.samples(number, fmt, values, [BEGIN_S + each for each in told])


def _folder(outcome: Outcome, name: str) -> Path:
    (written,) = (each for each in outcome.written if each.format == name)
    return written.path


def _notes(outcome: Outcome, name: str) -> list[str]:
    (written,) = (each for each in outcome.written if each.format == name)
    return [each for each in written.notes if "marker" in each]


def _annotated(path: Path) -> list[tuple[float, str]]:
    told = [(round(each.onset, 3), each.text) for each in read_bdf(path).annotations]
    return [each for each in told if not each[1].startswith(("LSL time", "end of data"))]


@pytest.mark.parametrize(("kind", "fmt"), KINDS)
def test_markers_of_any_type_are_in_every_format(kind: str, fmt: str, exported: Exporting) -> None:
    content = made.xdf(_skin((0, 10)), _markers(2, kind, fmt, {1.0: "7", 2.5: "8"}))
    outcome = exported(content, "edf", "ledalab", "bids")
    number = {"string": "{}", "float32": "{}.0"}.get(fmt, "{}")
    texts = [number.format(each) for each in (7, 8)]
    assert _annotated(_folder(outcome, "edf") / "skin.bdf") == [(1.0, texts[0]), (2.5, texts[1])]
    lines = (_folder(outcome, "ledalab") / "markers.csv").read_text().split()
    assert lines[1:] == [f'1,"{texts[0]}"', f'2,"{texts[1]}"']
    events = read(_folder(outcome, "bids"), "_events")
    assert events.of("value") == texts
    assert all(_notes(outcome, each.format) == [] for each in outcome.written)


def test_markers_outside_of_samples_are_in_the_file_before(exported: Exporting) -> None:
    told = {-500.0: "game", -1.0: "before", 1.0: "in", 12.0: "gap", 21.0: "in 2", 40.0: "after"}
    content = made.xdf(_skin((0, 10), (20, 30)), _markers(2, "markers", "string", told))
    outcome = exported(content, "edf", "ledalab")
    folder = _folder(outcome, "edf")
    assert _annotated(folder / "skin_run1.bdf") == [
        (-500.0, "game"),
        (-1.0, "before"),
        (1.0, "in"),
        (12.0, "gap"),
    ]
    assert _annotated(folder / "skin_run2.bdf") == [(1.0, "in 2"), (20.0, "after")]
    (note,) = _notes(outcome, "edf")
    assert note.startswith("skin: 4 of the markers came outside of its samples")
    left_out, late = _notes(outcome, "ledalab")
    assert left_out.startswith("skin: 3 of the markers came before its first or after its last")
    assert late.startswith("skin: 1 of the markers fell where samples are missing")


def test_a_marker_that_is_cut_off_is_said(exported: Exporting) -> None:
    texts = {1.0: "x" * 256, 2.0: "y" * 257}
    content = made.xdf(_skin((0, 10)), _markers(2, "Markers", "string", texts))
    outcome = exported(content, "edf")
    whole, cut = (text for _, text in _annotated(_folder(outcome, "edf") / "skin.bdf"))
    assert whole == texts[1.0]
    assert texts[2.0].startswith(cut.removesuffix("..."))
    (note,) = _notes(outcome, "edf")
    assert note.startswith("1 marker is cut off after 256 characters")


def test_very_many_markers_after_the_end_make_no_large_file(exported: Exporting) -> None:
    told = {40.0 + number / 100: f"number {number}" for number in range(1000)}
    content = made.xdf(_skin((0, 60)), _markers(2, "markers", "string", told))
    path = _folder(exported(content, "edf"), "edf") / "skin.bdf"
    assert len(_annotated(path)) == 1000
    assert path.stat().st_size < 200_000


TIME = st.integers(-5, 60).map(float)


@given(
    times=st.lists(TIME),
    begins=st.lists(st.tuples(TIME, st.integers(1, 9)), min_size=1),
)
def test_each_marker_is_in_one_file_at_least(
    times: list[float], begins: list[tuple[float, int]]
) -> None:
    spans = [Span(begin, begin + length) for begin, length in begins]
    happened = sorted((time, str(number)) for number, time in enumerate(times))
    found, outside = dealt_to_spans(happened, spans)
    assert {each for file in found for each in file} == set(happened)
    inside = {(time, text) for time, text in happened if any(a <= time < b for a, b in spans)}
    assert outside == len(happened) - len(inside)
    for span, file in zip(spans, found, strict=True):
        assert {each for each in inside if span.begin_s <= each[0] < span.end_s} <= set(file)
