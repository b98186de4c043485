"""A script reads the same of a recording, whether a window of LabRecorder makes it or not."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import pytest

from biosensor_gateway.cli.record import watch_file
from biosensor_gateway.recording.recorder.local import LocalRecorder
from biosensor_gateway.recording.recorder.programs import ProgramOutput
from biosensor_gateway.recording.recorder.request import (
    LocalStarted,
    LocalStatus,
    LocalStopped,
    Started,
    Status,
    Stopped,
)
from biosensor_gateway.recording.recorder.state import (
    LAB_RECORDER,
    RecorderFolder,
    SavedRecording,
    WindowRecording,
)
from tests.xdf.test_judging import acc, paused_recording


@pytest.mark.parametrize(
    ("of_a_window", "of_ours"),
    [(Started, LocalStarted), (Status, LocalStatus), (Stopped, LocalStopped)],
)
def test_a_recording_is_told_of_in_one_form(
    of_a_window: type[Started | Status | Stopped], of_ours: type[Started | Status | Stopped]
) -> None:
    assert [each.name for each in fields(of_ours)] == [each.name for each in fields(of_a_window)]


def test_the_last_words_have_no_letters_that_nobody_can_read() -> None:
    said = ProgramOutput(
        "Found a@pc matching 'x'\r\n\0\0\0\x07Started data collection for stream a.\r\n\0"
    )
    assert said.end == "Found a@pc matching 'x' / Started data collection for stream a."


def test_nothing_is_said_of_one_that_said_nothing() -> None:
    assert ProgramOutput("\0\0\r\n").end == "nothing"


def test_what_a_person_has_to_know_is_told_apart() -> None:
    said = ProgramOutput(
        "Found a@pc matching 'x'\nNote: a@pc has ended; 3 of its samples\r\na@pc goes on\n"
    )
    assert said.notes == ("a@pc has ended; 3 of its samples",)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    file = tmp_path / "a.xdf"
    file.write_bytes(b"XDF:")
    return file


@pytest.mark.parametrize(
    ("ended", "is_asked", "said"),
    [
        (2.0, False, "ended from outside"),
        # Whoever asked has not yet looked at the file, and says then how it is.
        (2.0, True, ""),
        (0.0, True, "supervisor was killed"),
    ],
)
def test_an_end_that_was_asked_for_is_no_problem(
    tmp_path: Path, file: Path, ended: float, is_asked: bool, said: str
) -> None:
    folder = RecorderFolder(tmp_path)
    kept = SavedRecording(str(file), (), started=1.0, program=1, ended=ended, code=0)
    folder.hand_over(kept, "")
    folder.save(kept)
    if is_asked:
        folder.ask_to_stop()
    standing = LocalRecorder(tmp_path).status()
    assert standing is not None
    assert not standing.recording
    problems = [each.text for each in standing.problems]
    assert len(problems) == bool(said)
    assert all(said in each for each in problems)


# What earlier versions have left in the state folder is read.
# As they were written: before there was a second program, before sensors could be left out on
# purpose, and before the command line was saved with it.
FIRST = (
    '{"file": "/data/a.xdf", "required": ["P01@polar_h10-ecg"], "started": 1795279855.5, '
    '"program": 4711, "ended": 0.0, "code": null, "problem": ""}'
)
SECOND = (
    '{"file": "/data/a.xdf", "required": ["P01@polar_h10-ecg"], "started": 1795279855.5, '
    '"program": 4711, "ended": 1795279900.0, "code": -9, "problem": "it was killed", '
    '"recorder": "the gateway\'s own recorder", "without": ["P02@zephyr-hr"]}'
)
OF_BOTH = ("/data/a.xdf", ("P01@polar_h10-ecg",), 1795279855.5, 4711)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (FIRST, SavedRecording(*OF_BOTH, recorder=LAB_RECORDER)),
        (
            SECOND,
            SavedRecording(
                *OF_BOTH,
                ended=1795279900.0,
                code=-9,
                problem="it was killed",
                recorder="the gateway's own recorder",
                without=("P02@zephyr-hr",),
            ),
        ),
    ],
)
def test_a_recording_of_this_computer(
    content: str, expected: SavedRecording, tmp_path: Path
) -> None:
    folder = RecorderFolder(tmp_path)
    folder.path.mkdir()
    (folder.path / "recording.json").write_text(content, encoding="utf-8")
    assert folder.saved() == expected


def test_a_recording_of_a_window(tmp_path: Path) -> None:
    content = '{"host": "lab-pc", "port": 22345, "file": "/data/b.xdf", "started": 1795279855.5}'
    (tmp_path / "recording.json").write_text(content, encoding="utf-8")
    last = WindowRecording.last_at(tmp_path, "LAB-PC", 22345)
    assert last == WindowRecording("lab-pc", 22345, "/data/b.xdf", 1795279855.5)


def test_of_a_window_it_is_watched_what_happened_so_far(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    beats = [
        {"event": "heartbeat", "lsl_time": at, "agent_started": started}
        for at, started in ((1003.0, 900.0), (1008.0, 900.0), (1012.0, 950.0))
    ]
    file = tmp_path / "a.xdf"
    file.write_bytes(paused_recording(*acc(1000, 1005), *acc(1009, 1020), more=beats))
    watch_file(file, as_json=False)
    said = capsys.readouterr().out
    assert "it belongs to another agent" in said
    assert "P01's Polar H10 was paused from" in said
    assert "gap so far" not in said
