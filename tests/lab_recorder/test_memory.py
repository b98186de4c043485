"""What is kept of the recording that was started last."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import pytest

from biosensor_gateway.recording.recorder.state import (
    WINDOW_FILE,
    WRITTEN_WITHIN_S,
    WindowRecording,
    file_going_on,
)

RECORDING = WindowRecording("127.0.0.1", 22345, "/data/a.xdf", 1795279855.5)


def test_it_is_kept_until_it_is_over(tmp_path: Path) -> None:
    folder = tmp_path / "not there yet"
    assert WindowRecording.last_at(folder, "127.0.0.1", 22345) is None
    assert RECORDING.save(folder) == ""
    assert WindowRecording.last_at(folder, "127.0.0.1", 22345) == RECORDING
    assert [path.name for path in folder.iterdir()] == [WINDOW_FILE]
    WindowRecording.forget(folder)
    WindowRecording.forget(folder)
    assert WindowRecording.last_at(folder, "127.0.0.1", 22345) is None


@pytest.mark.parametrize(
    ("host", "port", "is_known"),
    [
        ("localhost", 22345, True),
        ("::1", 22345, True),
        ("127.0.0.1", 22346, False),
        ("lab-pc", 22345, False),
    ],
)
def test_it_is_that_of_one_labrecorder(
    tmp_path: Path, host: str, port: int, is_known: bool
) -> None:
    RECORDING.save(tmp_path)
    assert (WindowRecording.last_at(tmp_path, host, port) is not None) is is_known


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"[]", b"\0", b"\xff", b"[" * 100_000, json.dumps({"host": "127.0.0.1"}).encode()],
)
def test_what_is_damaged_is_as_nothing(tmp_path: Path, content: bytes) -> None:
    (tmp_path / WINDOW_FILE).write_bytes(content)
    assert WindowRecording.last_at(tmp_path, "127.0.0.1", 22345) is None


def test_where_nothing_can_be_written_it_says_what_that_means(tmp_path: Path) -> None:
    in_the_way = tmp_path / "state"
    in_the_way.touch()
    assert "--file" in RECORDING.save(in_the_way)


@pytest.mark.parametrize(("age_s", "goes_on"), [(0.0, True), (2 * WRITTEN_WITHIN_S, False)])
def test_a_window_records_as_long_as_it_writes(age_s: float, goes_on: bool, tmp_path: Path) -> None:
    file = tmp_path / "a.xdf"
    assert file_going_on(tmp_path) is None
    WindowRecording("localhost", 22345, str(file), 1.0).save(tmp_path)
    assert file_going_on(tmp_path) is None
    file.touch()
    written = time.time() - age_s
    os.utime(file, (written, written))
    assert file_going_on(tmp_path) == (file if goes_on else None)
    WindowRecording.forget(tmp_path)
    assert file_going_on(tmp_path) is None
