"""Folders whose names have letters that a code page lacks."""

from __future__ import annotations

from pathlib import Path

import pytest

from biosensor_gateway.recording.recorder import program
from biosensor_gateway.recording.recorder.program import LAB_RECORDER, OWN
from biosensor_gateway.system.ansi_path import ansi_folder

FOLDER = Path("/users/\N{LATIN CAPITAL LETTER L WITH STROKE}ukasz/recorder")


@pytest.mark.parametrize(
    ("is_windows", "short", "expected"),
    [
        (False, "", FOLDER),
        (True, "/users/UKAS~1/RECORDER", Path("/users/UKAS~1/RECORDER")),
        # Disks need not keep short names, and they may have the same letters.
        (True, "", None),
        (True, str(FOLDER), None),
    ],
)
def test_a_folder_gets_a_name_of_few_letters(
    is_windows: bool, short: str, expected: Path | None
) -> None:
    found = ansi_folder(FOLDER, is_windows=is_windows, fits=str.isascii, short=lambda _: short)
    assert found == expected


def test_a_name_that_fits_stays() -> None:
    plain = Path("/users/ann")
    assert ansi_folder(plain, is_windows=True, fits=str.isascii, short=lambda _: "x") == plain


def test_where_labrecorder_could_not_read_session_and_peers_it_does_not_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would record in the default session, without known peers, and say nothing."""
    monkeypatch.setattr(program, "find_program", lambda: Path("/LabRecorderCLI"))
    named: list[Path | None] = [tmp_path]

    def ansi(_folder: Path) -> Path | None:
        return named[0]

    monkeypatch.setattr(program, "ansi_folder", ansi)
    found, said = program.find_programs(tmp_path)
    assert ([*found], said) == ([LAB_RECORDER, OWN], [])
    named[0] = None
    found, said = program.find_programs(tmp_path)
    assert [*found] == [OWN]
    assert str(tmp_path) in said[0]
