"""What is made of a file that is still being recorded would lack the rest, and is refused."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import pytest

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.cli.xdf import check as check_command
from biosensor_gateway.cli.xdf import salvage_recording
from biosensor_gateway.features.offline import compute
from biosensor_gateway.page.advice import clicked
from biosensor_gateway.recording.contents.choice import Selection
from biosensor_gateway.recording.export.exporter import Progress
from biosensor_gateway.recording.export.job import Task, export, export_several
from biosensor_gateway.recording.recorder.state import (
    RecorderFolder,
    SavedRecording,
    WindowRecording,
)
from biosensor_gateway.recording.replay.source import opened
from biosensor_gateway.recording.withdrawal.work import Action, carry_out, plan
from biosensor_gateway.settings.places import STATE_VARIABLE
from tests.xdf import xdf_file as x

WHOLE = b"".join(x.two_streams())
GROWING = WHOLE[: len(WHOLE) // 2]


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "state"
    folder.mkdir()
    monkeypatch.setenv(STATE_VARIABLE, str(folder))
    return folder


@pytest.fixture
def growing(state: Path, tmp_path: Path) -> Generator[Path]:
    """Yield a file that this computer's recorder writes."""
    file = tmp_path / "sub-P07" / "study.xdf"
    file.parent.mkdir()
    file.write_bytes(GROWING)
    folder = RecorderFolder(state)
    folder.path.mkdir()
    folder.save(SavedRecording(str(file), (), 1.0))
    lock = folder.try_lock()
    assert lock is not None
    yield file
    lock.release()


def _watch(_name: str, _s: float) -> Progress:
    return lambda _done: None


def _export(file: Path) -> object:
    return export(file, Task(("csv",), Selection()), _watch)


def _replay(file: Path) -> object:
    with opened(file) as contents:
        return contents


WAYS: dict[str, Callable[[Path], object]] = {
    "export": _export,
    "features": lambda file: compute(file, file.with_name("features.xdf")),
    "replay": _replay,
    "salvage": salvage_recording,
}


@pytest.mark.parametrize("way", WAYS)
def test_what_would_lack_the_rest_is_refused(growing: Path, way: str) -> None:
    # As somebody names it who stands in its folder.
    short = Path(os.path.relpath(growing))
    with pytest.raises(ConfigError, match="is still being recorded; end it first: ") as refused:
        WAYS[way](short)
    assert refused.value.reason is ConfigReason.IN_USE
    assert clicked(str(refused.value)).endswith("; click *Stop recording* first")
    assert list(growing.parent.iterdir()) == [growing]


def test_without_a_home_folder_files_can_be_read(
    growing: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in (STATE_VARIABLE, "HOME", "XDG_STATE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("os.getuid", lambda: 2**31 - 7, raising=False)
    _export(growing)


def test_the_others_of_a_study_are_exported(growing: Path, tmp_path: Path) -> None:
    other = tmp_path / "sub-P08" / "other.xdf"
    other.parent.mkdir()
    other.write_bytes(WHOLE)
    task = Task(("bids",), Selection(), output=tmp_path / "dataset")
    first, second = export_several([growing, other], task, lambda _file: nullcontext(_watch))
    assert "is still being recorded" in first.error
    assert second.outcome is not None


def test_nobody_is_withdrawn_from_it(growing: Path) -> None:
    made = plan("P07", [growing.parent])
    assert [each.action for each in made.steps] == [Action.LOOK]
    assert "it is still being recorded" in made.steps[0].why
    assert not carry_out(made).is_clean
    assert growing.read_bytes() == GROWING


def test_its_end_is_no_damage(growing: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check_command(growing)
    said = capsys.readouterr().out
    assert "warning: it is still being recorded: this is what is in it so far" in said
    assert "footer: the recorder" not in said
    assert "breaks off" not in said
    assert "salvage" not in said


@pytest.mark.parametrize(
    ("content", "age_s", "is_refused"),
    [(GROWING, 0, True), (WHOLE, 0, False), (GROWING, 600, False)],
)
def test_a_recording_in_labrecorders_window(
    state: Path, tmp_path: Path, content: bytes, age_s: float, is_refused: bool
) -> None:
    """It is over as soon as its file is closed, also if somebody closed it by hand."""
    file = tmp_path / "study.xdf"
    file.write_bytes(content)
    written = time.time() - age_s
    os.utime(file, (written, written))
    WindowRecording("localhost", 22345, str(file), written).save(state)
    if is_refused:
        with pytest.raises(ConfigError, match="still being recorded"):
            _export(file)
    else:
        _export(file)


def test_after_its_recorder_was_killed_it_can_be_read_and_is_said_to_have_no_end(
    state: Path, tmp_path: Path
) -> None:
    file = tmp_path / "study.xdf"
    file.write_bytes(GROWING)
    folder = RecorderFolder(state)
    folder.path.mkdir()
    folder.save(replace(SavedRecording(str(file), (), 1.0), program=1))
    outcome = export(file, Task(("csv",), Selection()), _watch)
    assert any("not closed, so its end may be missing" in each for each in outcome.clock_notes)
