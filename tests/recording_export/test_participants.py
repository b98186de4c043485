"""An export says whose data it writes where the recording's name and its sensors differ."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.recording.contents.choice import Wish
from biosensor_gateway.recording.export.exporting import Task, export
from biosensor_gateway.recording.export.outcome import Outcome
from biosensor_gateway.recording.export.printing import as_json, sentences
from biosensor_gateway.recording.participants import Whose
from tests.recording_export.bids_shapes import SHAPES, h10, ours, times
from tests.recording_export.bids_tables import read
from tests.xdf import xdf_file as made


def exported(folder: Path, content: bytes, participant: str, *formats: str,
             wish: Wish = Wish(), whose: Whose | None = None) -> Outcome:  # fmt: skip  # noqa: B008
    path = folder / f"sub-{participant}_ses-S001_task-walk_run-001_beh.xdf"
    path.write_bytes(content)
    task = Task(formats or ("bids",), wish, whose=whose)
    return export(path, task, lambda _name, _s: lambda _done: None)


def people(outcome: Outcome) -> list[str]:
    return sorted(each.name for each in outcome.written[0].path.glob("sub-*"))


def test_the_sensors_are_believed_and_the_other_name_is_said(tmp_path: Path) -> None:
    outcome = exported(tmp_path, SHAPES["two persons"], "P03")
    assert people(outcome) == ["sub-p01", "sub-p02"]
    assert (outcome.is_whole, outcome.is_certain) == (True, False)
    said = "\n".join(sentences(outcome))
    assert "the file is called P03, but its sensors are worn by p01 and p02" in said
    assert "--whose sensors" in said
    assert json.loads(as_json(outcome))["mismatch"]["others"] == ["p01", "p02"]


def test_whoever_says_that_the_sensors_are_right_is_believed(tmp_path: Path) -> None:
    outcome = exported(tmp_path, SHAPES["two persons"], "P03", whose=Whose.SENSORS)
    assert people(outcome) == ["sub-p01", "sub-p02"]
    assert outcome.is_certain


def test_the_name_may_be_right(tmp_path: Path) -> None:
    agent = DeviceIdentity("gateway", "lab-pc")
    texts = [[json.dumps({"event": "off_body", "participant": "p1"})]]
    events = ours(9, agent, "events", texts, times(1, 1.0), fmt="string", kind="Markers")
    content = made.xdf(h10(1, "p1"), events)
    outcome = exported(tmp_path, content, "P03", "bids", "csv-long", whose=Whose.NAME)
    assert people(outcome) == ["sub-P03"]
    assert outcome.is_certain
    dataset, table = (each.path for each in outcome.written)
    assert read(dataset, "sub-P03_ses-S001_task-walk_run-001_events").of("trial_type") == [
        "off_body"
    ]
    assert '"P03"' in table.read_text()
    assert '"p1",' not in table.read_text()


@pytest.mark.parametrize("participant", ["p01", "P01", "group1"])
def test_what_agrees_is_not_spoken_of(participant: str, tmp_path: Path) -> None:
    shape = "two persons" if participant.startswith("group") else "one person"
    assert exported(tmp_path, SHAPES[shape], participant).is_certain


def test_only_what_is_written_counts(tmp_path: Path) -> None:
    wish = Wish(participant="p01")
    assert exported(tmp_path, SHAPES["two persons"], "p01", wish=wish).is_certain
