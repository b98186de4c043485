"""What earlier versions have left in the state folder is read."""

from __future__ import annotations

from pathlib import Path

import pytest

from biosensor_gateway.recording.recorder.program import LAB_RECORDER
from biosensor_gateway.recording.recorder.state import (
    RecorderFolder,
    SavedRecording,
    WindowRecording,
)

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
