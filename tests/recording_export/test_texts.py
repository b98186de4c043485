"""Texts for Kubios and Ledalab."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np
import pytest

from biosensor_gateway.recording.contents.choice import Wish
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from tests.recording_export.conftest import Exporting
from tests.recording_export.study import BEGIN_S, ecg_values, study
from tests.xdf import xdf_file as made


def test_intervals_are_a_line_each(exported: Exporting) -> None:
    (written,) = exported(study(), "kubios").written
    intervals = (written.path / "P1-polar_h10-U1-ibi.txt").read_bytes()
    assert intervals == b"0.8\n" * 19
    assert "P1-polar_h10-U1-ibi: 1 samples are no interval and left out" in written.notes


def test_an_ecg_is_cut_at_its_gaps(exported: Exporting) -> None:
    (written,) = exported(study(), "kubios").written
    parts = [np.loadtxt(written.path / f"P1-polar_h10-U1-ecg_run{n}.txt") for n in (1, 2)]
    assert [len(each) for each in parts] == [1300, 1300]
    found = np.concatenate(parts).astype(np.float32)
    assert found.tolist() == ecg_values(2600)[:, 0].tolist()
    (rate,) = [each for each in written.notes if "tell Kubios" in each]
    assert "130 Hz" in rate
    assert "microvolts" in rate


def test_missing_beats_are_said(exported: Exporting) -> None:
    stamps = [*(BEGIN_S + 0.8 * n for n in range(10)), *(BEGIN_S + 60 + 0.8 * n for n in range(9))]
    header = made.stream_header(1, "beats", kind="RR", desc=_unit("ms"))
    content = made.xdf(header, made.samples(1, "float32", [[800]] * 19, stamps))
    (written,) = exported(content, "kubios").written
    assert any("beats of 52 s in all are missing" in each for each in written.notes)
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
    assert any("turned" in each for each in written.notes) == (unit != "uS")


def test_why_nothing_can_be_read_is_said(exported: Exporting) -> None:
    broken = made.stream_header(1, "skin", kind="GSR", rate=4.0).replace(b">4.0<", b">4,0<")
    content = made.xdf(broken, made.samples(1, "float32", [[1.0]], [BEGIN_S]))
    with pytest.raises(RecordingError, match=r"nominal rate.*salvage") as caught:
        exported(content, "csv")
    assert caught.value.reason is RecordingReason.EMPTY


@pytest.mark.parametrize("name", ["kubios", "ledalab", "edf"])
def test_a_format_without_anything_for_it_is_one_sentence(name: str, exported: Exporting) -> None:
    with pytest.raises(RecordingError, match="nothing was written") as caught:
        exported(study(), name, wish=Wish(streams=["*markers"]))
    assert caught.value.reason is RecordingReason.EMPTY
    assert "\n" not in str(caught.value)


def _unit(unit: str) -> ET.Element:
    desc = ET.Element("desc")
    channel = ET.SubElement(ET.SubElement(desc, "channels"), "channel")
    ET.SubElement(channel, "label").text = "RR"
    ET.SubElement(channel, "unit").text = unit
    return desc
