"""What the installer's folder does to a PATH, and that its removal undoes it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.recording.recorder import program
from biosensor_gateway.recording.recorder.program import LAB_RECORDER, OWN, ansi_folder
from biosensor_gateway.system.windows_setup import with_folder, without_folder

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

FOLDER = r"C:\Program Files\Biosensor Gateway"
SYSTEM = r"%SystemRoot%\system32;%SystemRoot%;%SYSTEMROOT%\System32\WindowsPowerShell\v1.0"
LONG = ";".join(rf"C:\Programs\{number:04}\bin" for number in range(240))

# Ways to write the same folder, as installers and people do.
SAME = [
    FOLDER,
    FOLDER + "\\",
    FOLDER + "\\\\",
    FOLDER.upper(),
    f'"{FOLDER}"',
    f'"{FOLDER}\\"',
    f"  {FOLDER} ",
]
OTHER = [
    r"C:\Program Files",
    FOLDER + " 2",
    FOLDER + r"\_internal",
    FOLDER.replace("C:", "D:"),
    r"%ProgramFiles%\Biosensor Gateway",
]


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("", FOLDER),
        (r"C:\Windows", rf"C:\Windows;{FOLDER}"),
        (SYSTEM, f"{SYSTEM};{FOLDER}"),
        (r"C:\Windows\;", rf"C:\Windows\;{FOLDER};"),
        (r"C:\a;;C:\b", rf"C:\a;;C:\b;{FOLDER}"),
        (r"C:\a;;", rf"C:\a;;{FOLDER};"),
        (r'"C:\with space";C:\b', rf'"C:\with space";C:\b;{FOLDER}'),
        (LONG, f"{LONG};{FOLDER}"),
    ],
)
def test_the_folder_comes_last(path: str, expected: str) -> None:
    assert with_folder(path, FOLDER) == expected
    assert without_folder(expected, FOLDER) == path


def test_a_path_longer_than_nsis_can_read_keeps_every_entry() -> None:
    assert len(LONG) > 5000
    entries = with_folder(LONG, FOLDER).split(";")
    assert entries == [*LONG.split(";"), FOLDER]


@pytest.mark.parametrize("written", SAME)
def test_a_folder_that_is_there_is_not_added_again(written: str) -> None:
    for path in (written, f"{written};{SYSTEM}", f"{SYSTEM};{written};", f"{written};{written}"):
        assert with_folder(path, FOLDER) == path


@pytest.mark.parametrize("written", SAME)
@pytest.mark.parametrize("asked", SAME)
def test_it_is_removed_however_it_is_written(written: str, asked: str) -> None:
    assert without_folder(written, asked) == ""
    assert without_folder(f"{written};{SYSTEM};{written};", asked) == f"{SYSTEM};"
    assert without_folder(f"{SYSTEM};{written}", asked) == SYSTEM


@pytest.mark.parametrize("other", OTHER)
def test_other_folders_are_not_taken_for_it(other: str) -> None:
    assert with_folder(other, FOLDER) == f"{other};{FOLDER}"
    assert without_folder(f"{other};{FOLDER}", FOLDER) == other
    assert without_folder(other, FOLDER) == other


def test_letters_beyond_ascii_count_as_windows_compares_them() -> None:
    assert without_folder(r"C:\RÄUME\Gateway", r"C:\Räume\gateway") == ""
    assert without_folder(r"C:\Strasse", r"C:\Straße") == r"C:\Strasse"


def test_a_folder_with_a_semicolon_is_refused() -> None:
    with pytest.raises(ValueError, match=r"C:\\a;b has a semicolon"):
        with_folder(SYSTEM, r"C:\a;b")
    assert without_folder(rf"C:\a;b;{SYSTEM}", r"C:\a;b") == rf"C:\a;b;{SYSTEM}"


@given(st.lists(st.text('abC:\\%" é', max_size=12), max_size=30).map(";".join))
def test_removal_leads_back_to_what_was_there(path: str) -> None:
    added = with_folder(path, FOLDER)
    assert added.split(";").count(FOLDER) == 1
    assert with_folder(added, FOLDER) == added
    assert without_folder(added, FOLDER) == path


@pytest.mark.parametrize("command", ["add-to-path", "remove-from-path"])
def test_other_systems_refuse_in_one_sentence(run: Callable[..., Outcome], command: str) -> None:
    outcome = run("installation", command, "/opt/gateway")
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err.startswith("biosensor-gateway: the PATH of this PC cannot be changed: ")
    assert outcome.err.count("\n") == 1


ANSI_FOLDER = Path("/users/\N{LATIN CAPITAL LETTER L WITH STROKE}ukasz/recorder")


@pytest.mark.parametrize(
    ("is_windows", "short", "expected"),
    [
        (False, "", ANSI_FOLDER),
        (True, "/users/UKAS~1/RECORDER", Path("/users/UKAS~1/RECORDER")),
        # Disks need not keep short names, and they may have the same letters.
        (True, "", None),
        (True, str(ANSI_FOLDER), None),
    ],
)
def test_a_folder_gets_a_name_of_few_letters(
    is_windows: bool, short: str, expected: Path | None
) -> None:
    found = ansi_folder(ANSI_FOLDER, is_windows=is_windows, fits=str.isascii, short=lambda _: short)
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
