"""A recording that takes several tries to begin, with a supervisor that is none."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import pytest

from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.recording.recorder import local
from biosensor_gateway.recording.recorder.local import LocalRecorder
from biosensor_gateway.recording.recorder.recording_file import FileSummary, summarize
from biosensor_gateway.recording.recorder.request import (
    RecorderError,
    RecorderReason,
    RecordingRequest,
)
from biosensor_gateway.recording.recorder.state import RecorderFolder, SavedRecording
from biosensor_gateway.recording.recorder.streams import Presence, VisibleStream
from biosensor_gateway.recording.xdf.verdict import Colour, Verdict
from tests.xdf.test_participants import heartbeat, recorded, strap


def test_the_next_try_begins_with_an_empty_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, sizes = tmp_path / "a.xdf", list[int]()

    def launch(state: Path) -> None:
        """Find no stream, having written something; the second time, not even run."""
        sizes.append(file.stat().st_size)
        if len(sizes) == 2:
            raise OSError("enough")
        file.write_bytes(b"XDF: and what was found")
        folder = RecorderFolder(state)
        folder.save(replace(folder.requested(), started=time.time(), ended=time.time(), code=2))

    monkeypatch.setattr(local, "launch", launch)
    stream = VisibleStream("a", "a-id", "here")
    with pytest.raises(RecorderError) as refused:
        local.LocalRecorder(tmp_path / "state").start(
            RecordingRequest(file=file), lambda: Presence((stream,), (), ())
        )
    assert refused.value.reason is RecorderReason.UNWRITABLE
    assert sizes == [0, 0]


AWAY = "polar_h10/A1 of P01 was paused the whole time, and "


@pytest.fixture(autouse=True)
def empty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.xdf.test_participants.STAMPS", [])
    # Nobody writes the file, so there is no need to wait until that has ended.
    monkeypatch.setattr(local, "wait_until_closed", _closed)


def _closed(file: Path, *_: object) -> FileSummary:
    return summarize(file)


def ended(folder: Path, *without: str) -> Verdict:
    """End a recording in which a strap of P01 has sent nothing."""
    file = folder / "sub-P01_ses-S001_task-Default_run-001_eeg.xdf"
    other = DeviceIdentity("zephyr", "B", "P01")
    events: list[object] = [heartbeat(polar_h10__A1="paused", zephyr__B="streaming")]
    file.write_bytes(recorded(strap("P01"), other, events=events))
    kept = SavedRecording(str(file), (), started=1.0, ended=2.0, code=0, without=without)
    recorder = RecorderFolder(folder)
    recorder.hand_over(kept, "")
    recorder.save(kept)
    return LocalRecorder(folder).stop().verdict


def test_it_is_amber_with_a_sentence(tmp_path: Path) -> None:
    verdict = ended(tmp_path, "P01@polar_h10-hr", "P01@polar_h10-ecg")
    texts = [each.text for each in verdict.findings if each.code == "away"]
    assert texts == [f"{AWAY}was left out on purpose: nothing of it is there"]
    assert verdict.colour is Colour.AMBER


def test_without_a_word_of_a_person_it_is_red(tmp_path: Path) -> None:
    verdict = ended(tmp_path, "P01@zephyr-hr")
    texts = [each.text for each in verdict.findings if each.code == "away"]
    assert texts == [f"{AWAY}nothing of it was recorded"]
    assert verdict.colour is Colour.RED
