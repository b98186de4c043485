"""Which name LabRecorder is told, and where its file will be."""

from __future__ import annotations

from pathlib import Path

import pytest

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.recording.recorder.request import BidsLabels, RecordingRequest, choose_target

LABELS = BidsLabels("P07", "S2", "Walk", 12, "left", "EEG")


def test_a_bids_name_is_told_with_placeholders_that_keep_their_case(tmp_path: Path) -> None:
    target = choose_target(RecordingRequest(tmp_path, labels=LABELS), is_local=True)
    name = "sub-P07/ses-S2/eeg/sub-P07_ses-S2_task-Walk_acq-left_run-012_eeg.xdf"
    assert target.files == (tmp_path / name,)
    assert target.template == target.template.lower()
    assert target.command.startswith(
        f"filename {{root:{tmp_path}}}{{template:sub-%p/ses-%s/%m/sub-%p_ses-%s_task-%b_acq-%a_run"
    )


def test_the_run_is_told_last_because_a_task_or_modality_resets_it() -> None:
    command = choose_target(RecordingRequest(Path("/data"), labels=LABELS), is_local=True).command
    assert command.endswith("{run:12}")
    assert command.index("{template:") < command.index("{task:") < command.index("{run:")


def test_without_an_acquisition_the_name_has_none() -> None:
    target = choose_target(RecordingRequest(Path("/data"), labels=BidsLabels("p1")), is_local=True)
    assert target.files[0].name == "sub-p1_ses-S001_task-Default_run-001_beh.xdf"
    assert "acq" not in target.command


def test_a_file_is_looked_for_in_lower_case_and_as_it_was_given(tmp_path: Path) -> None:
    target = choose_target(RecordingRequest(file=tmp_path / "Sub" / "Night.xdf"), is_local=True)
    assert target.files == (tmp_path / "Sub" / "night.xdf", tmp_path / "Sub" / "Night.xdf")
    assert target.command == f"filename {{root:{tmp_path / 'Sub'}}}{{template:night.xdf}}"


def test_a_relative_file_is_below_the_folder_else_below_the_working_folder() -> None:
    file = Path("day/one.xdf")
    assert choose_target(RecordingRequest(Path("/data"), file=file), is_local=True).files == (
        Path("/data/day/one.xdf"),
    )
    assert choose_target(RecordingRequest(file=file), is_local=True).files == (Path.cwd() / file,)


def test_another_computer_may_call_the_folder_differently(tmp_path: Path) -> None:
    file, there = Path("day/one.xdf"), "D:\\Studies"
    target = choose_target(RecordingRequest(tmp_path, there, file), is_local=False)
    assert target.command == "filename {root:D:\\Studies/day}{template:one.xdf}"
    assert target.files == (tmp_path / "day" / "one.xdf",)
    target = choose_target(RecordingRequest(tmp_path, there, labels=LABELS), is_local=False)
    assert "{root:D:\\Studies}" in target.command
    assert target.files[0].is_relative_to(tmp_path)


def test_of_another_computer_nothing_is_seen_without_a_folder() -> None:
    assert choose_target(RecordingRequest(), is_local=False).command == ""
    for place in (
        RecordingRequest(file=Path("one.xdf")),
        RecordingRequest(labels=LABELS),
        RecordingRequest(),
    ):
        target = choose_target(place, is_local=False)
        assert (target.folder, target.files, target.root) == (None, (), "")


def test_a_folder_alone_leaves_the_name_to_labrecorder(tmp_path: Path) -> None:
    target = choose_target(RecordingRequest(tmp_path), is_local=True)
    assert target.command == f"filename {{root:{tmp_path}}}"
    assert (target.folder, target.files) == (tmp_path, ())


@pytest.mark.parametrize(
    ("place", "words"),
    [
        (RecordingRequest(), "--folder"),
        (RecordingRequest(file=Path("notes.txt")), ".xdf"),
        (RecordingRequest(file=Path("100%p.xdf")), "%"),
        (RecordingRequest(file=Path("a}{task:b.xdf")), "braces"),
        (RecordingRequest(Path("/a{b}"), labels=LABELS), "braces"),
        (RecordingRequest(Path("/a\nstop"), labels=LABELS), "control characters"),
        (RecordingRequest(Path("/data"), file=Path("one.xdf"), labels=LABELS), "not both"),
        (RecordingRequest(Path("/data"), file=Path("/one.xdf")), "relative to --folder"),
    ],
)
def test_what_makes_no_sense_is_refused(place: RecordingRequest, words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        choose_target(place, is_local=True)
    assert caught.value.reason is ConfigReason.WRONG_VALUE


def test_a_path_of_this_computer_means_nothing_to_another() -> None:
    with pytest.raises(ConfigError, match="--recorder-folder"):
        choose_target(RecordingRequest(file=Path("/data/one.xdf")), is_local=False)


@pytest.mark.parametrize("label", ["p_01", "p-01", "p 01", "", "müller", "a}{run:2"])
def test_a_participant_is_a_bids_label(label: str) -> None:
    with pytest.raises(ConfigError, match="letters and digits"):
        BidsLabels(label)


@pytest.mark.parametrize("run", [0, 1001])
def test_a_run_is_what_labrecorder_s_field_takes(run: int) -> None:
    with pytest.raises(ConfigError, match="1000"):
        BidsLabels("p01", run=run)
