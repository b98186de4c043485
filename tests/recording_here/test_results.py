"""A script reads the same of a recording, whether a window of LabRecorder makes it or not."""

from __future__ import annotations

from dataclasses import fields

import pytest

from biosensor_gateway.recording.recorder.result import (
    Standing,
    StandingHere,
    Started,
    StartedHere,
    Stopped,
    StoppedHere,
)


@pytest.mark.parametrize(
    ("of_a_window", "of_ours"),
    [(Started, StartedHere), (Standing, StandingHere), (Stopped, StoppedHere)],
)
def test_a_recording_is_told_of_in_one_form(
    of_a_window: type[Started | Standing | Stopped], of_ours: type[Started | Standing | Stopped]
) -> None:
    assert [each.name for each in fields(of_ours)] == [each.name for each in fields(of_a_window)]
