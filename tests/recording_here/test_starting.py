"""A recording that takes several tries to begin, with a supervisor that is none."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import pytest

from biosensor_gateway.recording.recorder import local
from biosensor_gateway.recording.recorder.request import (
    RecorderError,
    RecorderReason,
    RecordingRequest,
)
from biosensor_gateway.recording.recorder.state import RecorderFolder
from biosensor_gateway.recording.recorder.streams import Presence, VisibleStream


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
