"""A script reads the same of a recording, whether a window of LabRecorder makes it or not."""

from __future__ import annotations

from dataclasses import fields

import pytest

from biosensor_gateway.recording.recorder.result import (
    LocalStarted,
    LocalStatus,
    LocalStopped,
    Started,
    Status,
    Stopped,
)


@pytest.mark.parametrize(
    ("of_a_window", "of_ours"),
    [(Started, LocalStarted), (Status, LocalStatus), (Stopped, LocalStopped)],
)
def test_a_recording_is_told_of_in_one_form(
    of_a_window: type[Started | Status | Stopped], of_ours: type[Started | Status | Stopped]
) -> None:
    assert [each.name for each in fields(of_ours)] == [each.name for each in fields(of_a_window)]
