"""``xdf salvage`` as a process: what it prints and writes, and its exit codes."""

from __future__ import annotations

import json
import os
import re
import stat
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

import pytest

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.recording.xdf.container import (
    Chunk,
    Damage,
    RecordingError,
    RecordingReason,
)
from biosensor_gateway.recording.xdf.salvage import survey
from biosensor_gateway.recording.xdf.salvage.outcome import salvage
from tests.faults.scenarios.namespace import MountNamespace
from tests.rigs.terminal import at_terminal
from tests.xdf import xdf_file as x
from tests.xdf.conftest import Command

WHOLE = b"".join(x.two_streams())
CUT = WHOLE[: len(WHOLE) // 2]


@pytest.mark.nightly
def test_a_cut_recording(command: Command) -> None:
    target = command.recording.with_name("study_salvaged.xdf")
    code, printed, said = command(str(command.recording), content=CUT, command="salvage")
    assert (code, said) == (0, "")
    lines = printed.splitlines()
    assert lines[0].startswith(f"{command.recording}: ")
    assert lines[0].endswith(" bytes, in 1 place, cannot be read")
    assert lines[1].startswith("  from byte ")
    assert lines[2].split() == ["stream", "samples", "kept", "lost"]
    assert lines[-2] == "2 streams got a footer with the number of samples kept"
    assert lines[-1].startswith(f"wrote {target}; ")
    assert command(str(target))[0] == 0
    again, printed, said = command(str(command.recording), command="salvage")
    assert (again, printed) == (2, "")
    assert said.startswith(f"biosensor-gateway: {target} exists")
    assert len(said.splitlines()) == 1


@pytest.mark.nightly
def test_a_whole_recording(command: Command) -> None:
    code, printed, said = command(str(command.recording), content=WHOLE, command="salvage")
    assert (code, said) == (0, "")
    assert printed.startswith(f"{command.recording} is whole")
    assert len(printed.splitlines()) == 1


@pytest.mark.nightly
def test_json_says_the_same(command: Command, tmp_path: Path) -> None:
    other = tmp_path / "other.xdf"
    options = ("--json", "--output", str(other))
    code, printed, _ = command(str(command.recording), *options, content=CUT, command="salvage")
    told = json.loads(printed)
    assert (code, told["written"], told["whole"]) == (0, str(other), False)
    assert [each["name"] for each in told["streams"]] == ["numbers", "events"]
    assert all(each["kept"] > 0 and each["new_footer"] for each in told["streams"])
    (damage,) = told["damages"]
    assert damage["end_s"] is None
    assert told["lost_bytes"] == damage["end"] - damage["start"]


@pytest.mark.nightly
def test_what_is_no_recording_is_a_wrong_command(command: Command, tmp_path: Path) -> None:
    missing = str(tmp_path / "none.xdf")
    for path, content in ((missing, None), (str(command.recording), b"no")):
        code, printed, said = command(path, content=content, command="salvage")
        assert (code, printed) == (2, "")
        assert path in said
    assert [each.name for each in tmp_path.iterdir()] == ["study.xdf"]


@pytest.mark.nightly
def test_nothing_to_salvage_fails(command: Command, tmp_path: Path) -> None:
    code, printed, said = command(str(command.recording), content=CUT[:100], command="salvage")
    assert (code, printed) == (1, "")
    assert "holds no readable samples" in said
    assert [each.name for each in tmp_path.iterdir()] == ["study.xdf"]


@pytest.mark.nightly
def test_it_fits_a_terminal_of_80_columns() -> None:
    name = "participant-0123-left-upper-arm-polar_h10-" + "E621E1F8-C36C-495A-93FC-0C247A3E6E5F"
    stamps = [100 + k / 10 for k in range(300)]
    header, samples, _ = x.regular(1, name, stamps, 10.0)
    _, later, _ = x.regular(1, name, [30 + each for each in stamps], 10.0)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "study.xdf"
        path.write_bytes(x.xdf(header, samples, b"\xee" * 30, later, later[:-1]))
        line = [sys.executable, "-m", "biosensor_gateway.cli", "xdf", "salvage", str(path)]
        with at_terminal(line, os.environ, columns=80) as terminal:
            assert terminal.exit_code() == 0
            shown = re.sub(r"\x1b\[\d*m", "", terminal.raw)
    lines = [each.rstrip() for each in shown.split("\r\n")]
    assert max(map(len, lines)) <= 80
    assert "600" in shown
    assert "xdf check" in " ".join(shown.split())


@pytest.fixture
def cut(tmp_path: Path) -> Path:
    path = tmp_path / "study.xdf"
    path.write_bytes(CUT)
    return path


@pytest.mark.parametrize("kind", ["file", "folder", "link", "itself"])
def test_nothing_is_overwritten(kind: str, cut: Path, tmp_path: Path) -> None:
    target = cut if kind == "itself" else tmp_path / "other.xdf"
    if kind == "file":
        target.write_bytes(b"precious")
    elif kind == "folder":
        target.mkdir()
    elif kind == "link":
        target.symlink_to(tmp_path / "nowhere")
    with pytest.raises(ConfigError) as caught:
        salvage(cut, target)
    assert caught.value.reason is ConfigReason.EXISTS
    assert cut.read_bytes() == CUT
    assert kind != "file" or target.read_bytes() == b"precious"
    assert not (tmp_path / "nowhere").exists()


def test_the_result_has_no_other_suffix(cut: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"ends in \.xdf"):
        salvage(cut, tmp_path / "other.xdfz")


@pytest.mark.parametrize("folder", ["none", "study.xdf"])
def test_where_no_file_can_be_it_says_so(folder: str, cut: Path, tmp_path: Path) -> None:
    with pytest.raises(RecordingError) as caught:
        salvage(cut, tmp_path / folder / "other.xdf")
    assert caught.value.reason is RecordingReason.UNWRITABLE
    assert "cannot write" in str(caught.value)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows knows no such modes")
def test_who_may_not_read_the_recording_may_not_read_the_result(cut: Path, tmp_path: Path) -> None:
    cut.chmod(0o400)
    salvage(cut, tmp_path / "other.xdf")
    assert stat.S_IMODE((tmp_path / "other.xdf").stat().st_mode) == 0o600


def test_a_recording_that_grows_is_left_alone(
    cut: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = survey.read_chunks

    def read_while_it_grows(
        file: BinaryIO, size: int, take: Callable[[Chunk], None]
    ) -> tuple[Damage, ...]:
        with cut.open("ab") as recorder:
            recorder.write(b"more")
        return read(file, size, take)

    monkeypatch.setattr(survey, "read_chunks", read_while_it_grows)
    with pytest.raises(RecordingError) as caught:
        salvage(cut, tmp_path / "other.xdf")
    assert caught.value.reason is RecordingReason.GROWS
    assert [each.name for each in tmp_path.iterdir()] == ["study.xdf"]


@pytest.mark.system
@pytest.mark.parametrize(
    ("mounts", "why"),
    [
        (
            ("mount --bind {0} {0}", "mount -o remount,ro,bind {0}"),
            "Read-only file system; choose a place on another disk",
        ),
        (
            ("mount -t tmpfs -o size=4k tmpfs {0}",),
            "No space left on device; free some space on that disk",
        ),
    ],
)
def test_a_folder_that_takes_nothing_keeps_nothing(
    mounts: tuple[str, ...], why: str, cut: Path, command: Command, tmp_path: Path
) -> None:
    cut.write_bytes(WHOLE[:-1])
    folder = tmp_path / "folder"
    folder.mkdir()
    commands = [each.format(folder) for each in mounts]
    with MountNamespace(*commands) as namespace:
        inside = namespace.path(folder)
        output = ("--output", str(inside / "other.xdf"))
        code, printed, said = command(str(cut), *output, command="salvage")
        left = list(inside.iterdir())
    assert (code, printed, left) == (1, "", [])
    assert said.startswith("biosensor-gateway: cannot write ")
    assert why in said


# The command itself, as a process: what it prints, and its exit codes.


TIMES = [1000 + k / 10 for k in range(300)]
GOOD = x.xdf(*x.regular(1, "belt", TIMES, 10.0))
GAP = x.xdf(*x.regular(1, "belt", TIMES[:100] + TIMES[130:], 10.0))


@pytest.mark.seam
def test_a_good_recording(command: Command) -> None:
    code, printed, said = command(str(command.recording), content=GOOD)
    assert (code, said) == (0, "")
    lines = printed.splitlines()
    assert lines[0].startswith("belt: Test, 1 channel of float32, 10 Hz")
    assert "300 samples, 10 Hz measured, footer agrees" in lines[1]
    assert lines[-1] == f"{command.recording}: 1 stream, 29.9 s; no problem found"


@pytest.mark.nightly
def test_a_gap_is_a_warning_and_does_not_fail(command: Command) -> None:
    code, printed, _ = command(str(command.recording), content=GAP)
    assert code == 0
    assert "gaps (samples lost): 3.1 s at 9.9 s (30)" in printed
    assert "warning: belt: 1 gap of 3.1 s in total, about 30 samples lost" in printed
    summary, where = printed.splitlines()[-2:]
    assert summary.endswith("2 warnings")
    assert where.endswith("recording-troubleshooting.md")


@pytest.mark.nightly
def test_an_error_fails(command: Command) -> None:
    code, printed, _ = command(str(command.recording), content=GOOD[:-20])
    assert code == 1
    assert "error: the file breaks off at byte" in printed
    advice = "to write what can be read to another file: biosensor-gateway xdf salvage"
    assert printed.splitlines()[-1] == f"{advice} {command.recording}"


@pytest.mark.nightly
def test_json_of_a_check_says_the_same(command: Command) -> None:
    code, report = command.json(GAP)
    assert code == 0
    assert (report["good"], report["can_be_salvaged"]) == (True, False)
    (stream,) = report["streams"]
    assert stream["name"] == "belt"
    assert stream["samples"] == stream["footer_samples"] == 270
    assert stream["gaps"]["lost"] == 30
    assert stream["gaps"]["listed"][0]["at_s"] == pytest.approx(9.9)
    assert {f["code"] for f in report["findings"]} == {"gaps", "smeared-gaps"}
    code, report = command.json(GOOD[: len(GOOD) // 2])
    # Nothing of its only samples can be read.
    assert (code, report["good"], report["can_be_salvaged"]) == (1, False, False)
    assert report["damages"][0]["breaks_off"] is True


@pytest.mark.nightly
def test_expected_streams(command: Command) -> None:
    assert command.json(GOOD, "--expect", "belt")[0] == 0
    code, report = command.json(GOOD, "--expect", "belt", "--expect", "strap")
    assert code == 1
    assert [f["stream"] for f in report["findings"] if f["code"] == "missing"] == ["strap"]


@pytest.mark.nightly
@pytest.mark.parametrize("is_usual", [True, False])
def test_the_devices_of_the_settings_are_expected(
    is_usual: bool, command: Command, tmp_path: Path
) -> None:
    path = command.usual_settings if is_usual else tmp_path / "others.toml"
    path.write_text(
        '[[device]]\nsensor = "polar_h10"\nunit = "A1"\n'
        '[[device]]\nsensor = "polar_h10"\nunit = "A2"\nenabled = false\n'
    )
    arguments = [] if is_usual else ["--settings", str(path)]
    code, report = command.json(GOOD, *arguments)
    missing = {f["stream"] for f in report["findings"] if f["code"] == "missing"}
    assert code == 1
    assert "polar_h10-A1-ecg" in missing
    assert not any("A2" in name for name in missing)


@pytest.mark.nightly
def test_what_is_no_recording_cannot_be_checked(command: Command, tmp_path: Path) -> None:
    missing = str(tmp_path / "none.xdf")
    for path, content in ((missing, None), (str(command.recording), b"no"), (str(tmp_path), None)):
        code, printed, said = command(path, content=content)
        assert (code, printed) == (2, "")
        assert said.startswith("biosensor-gateway: ")
        assert path in said
        assert len(said.splitlines()) == 1


@pytest.mark.nightly
def test_wrong_arguments_and_settings_are_a_wrong_command(command: Command, tmp_path: Path) -> None:
    assert command()[0] == 2
    none = str(tmp_path / "none.toml")
    assert command(str(command.recording), "--settings", none, content=GOOD)[0] == 2
    command.usual_settings.write_text("[[device]\n")
    assert command(str(command.recording), content=GOOD)[0] == 2


@pytest.mark.nightly
def test_a_name_cannot_steer_the_terminal(command: Command) -> None:
    content = x.xdf(*x.regular(1, "be\u009b31mlt\u202e", TIMES, 10.0))
    code, printed, _ = command(str(command.recording), content=content)
    assert code == 0
    assert "be\ufffd31mlt\ufffd: Test" in printed
