"""What is said of a recording that nobody keeps any more."""

from __future__ import annotations

from pathlib import Path

import pytest

from biosensor_gateway.recording.recorder.local import LocalRecorder
from biosensor_gateway.recording.recorder.state import RecorderFolder, SavedRecording


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
