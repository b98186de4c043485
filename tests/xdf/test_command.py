"""The command itself, as a process: what it prints, and its exit codes."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.xdf import xdf_file as x
from tests.xdf.conftest import Command

pytestmark = pytest.mark.nightly

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


def test_a_gap_is_a_warning_and_does_not_fail(command: Command) -> None:
    code, printed, _ = command(str(command.recording), content=GAP)
    assert code == 0
    assert "gaps (samples lost): 3.1 s at 9.9 s (30)" in printed
    assert "warning: belt: 1 gap of 3.1 s together, about 30 samples lost" in printed
    summary, where = printed.splitlines()[-2:]
    assert summary.endswith("2 warnings")
    assert where.endswith("recording-troubleshooting.md")


def test_an_error_fails(command: Command) -> None:
    code, printed, _ = command(str(command.recording), content=GOOD[:-20])
    assert code == 1
    assert "error: the file breaks off at byte" in printed
    advice = "to write what can be read to another file: biosensor-gateway xdf salvage"
    assert printed.splitlines()[-1] == f"{advice} {command.recording}"


def test_json_says_the_same(command: Command) -> None:
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


def test_expected_streams(command: Command) -> None:
    assert command.json(GOOD, "--expect", "belt")[0] == 0
    code, report = command.json(GOOD, "--expect", "belt", "--expect", "strap")
    assert code == 1
    assert [f["stream"] for f in report["findings"] if f["code"] == "missing"] == ["strap"]


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


def test_what_is_no_recording_is_a_wrong_command(command: Command, tmp_path: Path) -> None:
    missing = str(tmp_path / "none.xdf")
    for path, content in ((missing, None), (str(command.recording), b"no"), (str(tmp_path), None)):
        code, printed, said = command(path, content=content)
        assert (code, printed) == (2, "")
        assert said.startswith("biosensor-gateway: ")
        assert path in said
        assert len(said.splitlines()) == 1


def test_wrong_arguments_and_settings_are_a_wrong_command(command: Command, tmp_path: Path) -> None:
    assert command()[0] == 2
    none = str(tmp_path / "none.toml")
    assert command(str(command.recording), "--settings", none, content=GOOD)[0] == 2
    command.usual_settings.write_text("[[device]\n")
    assert command(str(command.recording), content=GOOD)[0] == 2


def test_a_name_cannot_steer_the_terminal(command: Command) -> None:
    content = x.xdf(*x.regular(1, "be\u009b31mlt\u202e", TIMES, 10.0))
    code, printed, _ = command(str(command.recording), content=content)
    assert code == 0
    assert "be\ufffd31mlt\ufffd: Test" in printed
