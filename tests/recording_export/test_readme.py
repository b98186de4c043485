"""README.txt says what an export holds: files, people, units, and what is amiss."""

from __future__ import annotations

import pytest

from biosensor_gateway.recording.export.exporter import Clock, Times
from tests.recording_export.conftest import Exporting
from tests.recording_export.study import study

FOLDERS = ("csv", "csv.gz", "edf", "kubios", "ledalab", "mcap")


@pytest.mark.parametrize("name", FOLDERS)
def test_each_file_or_topic_is_named_with_what_it_is(name: str, exported: Exporting) -> None:
    (written,) = exported(study(), name).written
    text = (written.path / "README.txt").read_text("utf-8")
    listed = text.partition("HOW TO READ IT")[0]
    if name == "mcap":
        assert "/P1/biosensors/polar_h10/ecg_stamped" in listed
    else:
        data = [each.name for each in written.path.iterdir() if each.name.startswith("P")]
        assert data
        assert [each for each in data if each not in listed] == []
    person = "P2" if name == "ledalab" else "P1"
    assert f"of {person}, measured by" in " ".join(listed.split())


@pytest.mark.parametrize("name", FOLDERS)
def test_all_that_is_said_of_the_export_is_in_it(name: str, exported: Exporting) -> None:
    (written,) = exported(study(), name, times=Times.EVEN).written
    text = " ".join((written.path / "README.txt").read_text("utf-8").split())
    for note in written.notes:
        assert " ".join(note.split()) in text


def test_the_begin_is_told_on_the_clock_of_the_times(exported: Exporting) -> None:
    (written,) = exported(study(), "csv", clock=Clock.WALL).written
    text = (written.path / "README.txt").read_text("utf-8")
    assert "begins at 1790000000.250000, which is 2026-09-21T14:13:20.250000+00:00" in text
