"""Commands for the Windows installer: PATH, autostart, and programs that keep files open.

The installer looks for programs that it cannot close before it closes any: an agent that is
ended for an upgrade that then fails has lost its recording for nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from typing import Annotated, TypeVar

import psutil
import typer

from biosensor_common.errors import ConfigError, ConfigReason, TransportError, TransportReason
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.page.instance import LOCK_FILE, page_folder
from biosensor_gateway.recording.recorder.local import LocalRecorder
from biosensor_gateway.settings.places import state_folder
from biosensor_gateway.system import windows_setup

_PROGRAMS = frozenset({"biosensor-gateway.exe", "biosensor gateway.exe"})
_OF_PAGE = frozenset({"page", "play-recording"})
_OF_RECORDING = frozenset({"keep-recording", "record-streams"})
_OF_AGENT = frozenset({"run", "send-features"})
_Fact = TypeVar("_Fact")


@dataclass(frozen=True, slots=True)
class Program:
    """A process of one of our programs."""

    number: int
    user: str  # Empty if the system does not report it.
    words: tuple[str, ...]  # Its command line; empty if the system does not report it.
    # Process ids of itself, its ancestors and descendants, and of the other processes that its
    # agent's supervisor has started.
    family: frozenset[int]


@dataclass(frozen=True, slots=True)
class Closable:
    """The programs that one user's commands can close."""

    user: str
    agent: int | None  # Process id of the agent; None if none runs.
    # page, recording: whether one is running.
    page: bool
    recording: bool

    def closes(self, program: Program) -> bool:
        """Whether `record stop`, `page --end` or `stop` ends this program."""
        if program.user != self.user or not program.words:
            return False
        first = program.words[1] if len(program.words) > 1 else ""
        if first in _OF_AGENT:
            return self.agent in program.family
        if first in _OF_RECORDING:
            return self.recording
        # The program that is started without arguments opens the page. A page with --lsl has no
        # lock and takes no `page --end`.
        return (not first or first in _OF_PAGE) and self.page and "--lsl" not in program.words


def programs_not_closable(state: Path) -> list[str]:
    """Return a sentence for each running program that commands cannot close."""
    own = psutil.Process()
    # The installer itself is among the ancestors.
    ignored = {own.pid, *(each.pid for each in own.parents())}
    closing = Closable(
        own.username(),
        _agent(state),
        is_held(page_folder(state), LOCK_FILE),
        LocalRecorder(state).is_running,
    )
    programs = [each for each in _programs() if each.number not in ignored]
    return [sentence(each) for each in programs if not closing.closes(each)]


def sentence(program: Program) -> str:
    """Return which program it is, for a person."""
    command = " ".join(("biosensor-gateway", *program.words[1:2])) if program.words else "a program"
    whose = program.user or "another user"
    return f"{command} (process {program.number} of {whose})"


def _agent(state: Path) -> int | None:
    try:
        return int(status_file.read_status(state)["process"])
    except (ConfigError, KeyError, TypeError, ValueError):
        return None


def _programs() -> Iterator[Program]:
    for process in psutil.process_iter():
        words = _words(process)
        name = _reported(process.name, PureWindowsPath(words[0]).name if words else "")
        if name.lower() in _PROGRAMS:
            user = _reported(process.username, "")
            yield Program(process.pid, user, words, frozenset(_family(process)))


def _words(process: psutil.Process) -> tuple[str, ...]:
    return tuple(_reported(process.cmdline, ()))


def _reported(ask: Callable[[], _Fact], otherwise: _Fact) -> _Fact:
    """Return the system's report on a process; it may be empty for other users' processes."""
    try:
        return ask()
    except (psutil.Error, OSError):
        return otherwise


def _family(process: psutil.Process) -> Iterator[int]:
    yield process.pid
    try:
        for parent in process.parents():
            yield parent.pid
            # The agent's supervisor has also started its warm spare, which is not a descendant.
            if _words(parent)[1:2] == ("run",):
                yield from (each.pid for each in parent.children())
        yield from (each.pid for each in process.children(recursive=True))
    except (psutil.Error, OSError):
        return


app = typer.Typer(no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Used by the Windows installer."""  # noqa: D401 - as the list has it


FolderArgument = Annotated[str, typer.Argument(help="Folder of the program.")]
EXIT_NOT_CHOSEN = 3
"""Exit code of ``autostart-state``; not 1, which any error has."""
EXIT_HELD = 4
"""Exit code of ``holders``; not 2, with which versions end that lack the command."""


@app.command("add-to-path")
def add_to_path(folder: FolderArgument) -> None:
    """Add the program's folder to the user's PATH."""
    _changed(windows_setup.add_to_path, folder)


@app.command("remove-from-path")
def remove_from_path(folder: FolderArgument) -> None:
    """Undo add-to-path."""
    _changed(windows_setup.remove_from_path, folder)


@app.command("autostart")
def autostart(
    command: Annotated[str, typer.Argument(help="The command to run; it may contain %VARIABLES%.")],
    on: Annotated[bool, typer.Option("--on/--off", help="Whether to start it at logon.")] = True,
) -> None:
    """Choose whether the program starts when the user of this session logs on."""
    _entries(lambda: windows_setup.choose(command, wanted=on))


@app.command("autostart-state")
def autostart_state() -> None:
    """End with 0 if the program starts when the user of this session logs on, else with 3."""
    if not windows_setup.is_chosen():
        raise typer.Exit(EXIT_NOT_CHOSEN)


@app.command("remove-autostart")
def remove_autostart() -> None:
    """Remove the start at logon for all users."""
    _entries(windows_setup.remove_all)


@app.command("holders")
def holders() -> None:
    """Print the running programs that no command can close; exit with 4 if there are any."""
    found = programs_not_closable(state_folder())
    for each in found:
        typer.echo(each)
    if found:
        raise typer.Exit(EXIT_HELD)


def _changed(change: Callable[[str], None], folder: str) -> None:
    try:
        change(folder)
    except ValueError as error:
        message = f"PATH cannot hold it: {error}; install into another folder"
        raise ConfigError(ConfigReason.WRONG_VALUE, message) from error
    except OSError as error:
        message = f"the PATH of this PC cannot be changed: {error.strerror or error}"
        raise TransportError(TransportReason.DENIED, message) from error


def _entries(change: Callable[[], None]) -> None:
    try:
        change()
    except OSError as error:
        message = f"the programs that start at logon cannot be changed: {error.strerror or error}"
        raise TransportError(TransportReason.DENIED, message) from error
