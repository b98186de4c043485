"""What the installed program asks of Windows: its PATH, its console, who holds a file."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from biosensor_gateway.cli import installation
from biosensor_gateway.cli.installation import Closable, Program, sentence
from biosensor_gateway.recording.recorder import programs
from biosensor_gateway.recording.recorder.programs import ansi_folder
from biosensor_gateway.recording.recorder.state import LAB_RECORDER, OWN
from biosensor_gateway.system.windows_console import (
    ENABLE_EXTENDED_FLAGS,
    ENABLE_QUICK_EDIT_MODE,
    is_own_window,
    quick_edit_off,
    without_quick_edit,
)
from biosensor_gateway.system.windows_setup import with_folder, without_folder
from tests.rigs.terminal import at_terminal

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

# What the installer's folder does to a PATH, and that its removal undoes it.

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
    monkeypatch.setattr(programs, "find_program", lambda: Path("/LabRecorderCLI"))
    named: list[Path | None] = [tmp_path]

    def ansi(_folder: Path) -> Path | None:
        return named[0]

    monkeypatch.setattr(programs, "ansi_folder", ansi)
    found, said = programs.find_programs(tmp_path)
    assert ([*found], said) == ([LAB_RECORDER, OWN], [])
    named[0] = None
    found, said = programs.find_programs(tmp_path)
    assert [*found] == [OWN]
    assert str(tmp_path) in said[0]


# QuickEdit is one flag among others, which must stay as they are.
# What a console of Windows 10 has, the same with Insert off, and one that has nothing.
@pytest.mark.parametrize(
    ("mode", "without"), [(0x01F7, 0x01B7), (0x01D7, 0x0197), (0x0000, 0x0080)]
)
def test_only_quick_edit_goes(mode: int, without: int) -> None:
    assert without_quick_edit(mode) == without
    changed = mode ^ without
    assert changed & ~(ENABLE_QUICK_EDIT_MODE | ENABLE_EXTENDED_FLAGS) == 0


@pytest.mark.skipif(sys.platform == "win32", reason="there it changes the console")
def test_other_systems_have_none() -> None:
    with quick_edit_off():
        pass


# What the installer cannot close, before it closes anything.
EXE = r"C:\Program Files\Biosensor Gateway\bin\biosensor-gateway.exe"
RUNNING = Closable("PC\\ann", agent=10, page=True, recording=True)


def started(*words: str, user: str = "PC\\ann", family: frozenset[int] = frozenset({5})) -> Program:
    return Program(5, user, (EXE, *words), family)


@pytest.mark.parametrize(
    "program",
    [
        started("run", family=frozenset({5, 10})),
        # The one that starts it again, one that waits to take over, and its features.
        started("run", "--keep-alive", family=frozenset({5, 10, 11})),
        started("send-features", family=frozenset({10, 5})),
        started("page", "--window"),
        started(),
        started("play-recording"),
        started("keep-recording", r"C:\state"),
        started("record-streams", "a.xdf", "(true())"),
    ],
)
def test_what_the_commands_end_is_closed(program: Program) -> None:
    assert RUNNING.closes(program)


@pytest.mark.parametrize(
    "program",
    [
        # Of another state folder.
        started("run"),
        started("run", user="PC\\bob", family=frozenset({5, 10})),
        started("page", user=""),
        started("page", "--lsl"),
        started("features"),
        started("replay", "a.xdf"),
        started("status", "--watch"),
        Program(5, "PC\\ann", (), frozenset({5, 10})),
    ],
)
def test_all_else_is_not(program: Program) -> None:
    assert not RUNNING.closes(program)


def test_where_nothing_runs_by_the_locks_nothing_is_closed() -> None:
    none = Closable("PC\\ann", agent=None, page=False, recording=False)
    for words in (("run",), ("page",), ("keep-recording", "x")):
        assert not none.closes(started(*words))


def test_a_sentence_says_which_and_whose() -> None:
    assert sentence(started("features")) == r"biosensor-gateway features (process 5 of PC\ann)"
    unknown = Program(7, "", (), frozenset({7}))
    assert sentence(unknown) == "a program (process 7 of another user)"


class _Process:
    """A process whose name the system does not tell, as under Wine."""

    def __init__(self, number: int, *words: str, parent: _Process | None = None) -> None:
        self.pid, self._words, self._parent = number, list(words), parent
        self._children: list[_Process] = []
        if parent is not None:
            parent._children.append(self)

    def name(self) -> str:
        raise OSError(22, "Invalid parameter")

    def cmdline(self) -> list[str]:
        return self._words

    def username(self) -> str:
        return psutil.Process().username()

    def parents(self) -> list[_Process]:
        return [] if self._parent is None else [self._parent, *self._parent.parents()]

    def children(self, *, recursive: bool = False) -> list[_Process]:
        below = [each for child in self._children for each in child.children(recursive=True)]
        return [*self._children, *(below if recursive else [])]


def test_the_command_names_them_and_its_code_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BIOSENSOR_GATEWAY_STATE", str(tmp_path))
    running = [_Process(1, r"C:\windows\explorer.exe"), _Process(2, EXE, "features")]
    monkeypatch.setattr(psutil, "process_iter", lambda: iter(running))
    outcome = CliRunner().invoke(installation.app, ["holders"])
    assert outcome.exit_code == installation.EXIT_HELD
    assert outcome.output.startswith("biosensor-gateway features (process 2 of ")
    assert len(outcome.output.splitlines()) == 1
    running.pop()
    assert installation.programs_not_closable(tmp_path) == []
    assert CliRunner().invoke(installation.app, ["holders"]).exit_code == 0


def test_what_waits_to_take_over_for_an_agent_is_closed_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BIOSENSOR_GATEWAY_STATE", str(tmp_path))
    supervisor = _Process(11, EXE, "run", "--keep-alive")
    agent, standby = (_Process(each, EXE, "run", parent=supervisor) for each in (10, 12))
    other = _Process(13, EXE, "run")
    monkeypatch.setattr(psutil, "process_iter", lambda: iter([supervisor, agent, standby, other]))

    def number_of_agent(_state: Path) -> int:
        return agent.pid

    monkeypatch.setattr(installation, "_agent", number_of_agent)
    (held,) = installation.programs_not_closable(tmp_path)
    assert "process 13 of" in held


_CODE = """
import sys
from biosensor_gateway import cli
from biosensor_gateway.system import windows_console
windows_console.is_own_window = lambda: True
sys.argv = ["biosensor-gateway", *{arguments!r}]
cli.main()
"""
CLOSE = "Press Enter to close this window."


def double_clicked(*arguments: str) -> list[str]:
    return [sys.executable, "-c", _CODE.format(arguments=list(arguments))]


def environment(folder: Path) -> dict[str, str]:
    state = {"BIOSENSOR_GATEWAY_STATE": str(folder / "state"), "TERM": "xterm"}
    return os.environ | state | {"BIOSENSOR_GATEWAY_SETTINGS": str(folder / "settings.toml")}


@pytest.mark.skipif(sys.platform == "win32", reason="there it may be one")
def test_other_systems_have_no_window_of_their_own() -> None:
    assert not is_own_window()


@pytest.mark.nightly
@pytest.mark.parametrize("typed", ["\n", "\x03", "\x04"], ids=["Enter", "Ctrl-C", "Ctrl-D"])
def test_what_fails_can_be_read(tmp_path: Path, typed: str) -> None:
    (tmp_path / "settings.toml").write_text("[lsl\n")
    with at_terminal(double_clicked("run"), environment(tmp_path)) as terminal:
        shown = terminal.until_seen(CLOSE)
        assert "not valid TOML" in " ".join(shown.split())
        terminal.type(typed)
        assert terminal.exit_code() == 2
    assert "Traceback" not in terminal.screen.text


@pytest.mark.nightly
def test_a_double_click_leads(tmp_path: Path) -> None:
    with at_terminal(double_clicked(), environment(tmp_path)) as terminal:
        terminal.until_seen("Type a number, then Enter [1]:")
        terminal.type("3\n")
        assert terminal.exit_code() == 0
    assert CLOSE not in terminal.screen.text


@pytest.mark.nightly
def test_what_ends_well_closes(tmp_path: Path) -> None:
    with at_terminal(double_clicked("config", "path"), environment(tmp_path)) as terminal:
        assert terminal.exit_code() == 0
    assert CLOSE not in terminal.screen.text
