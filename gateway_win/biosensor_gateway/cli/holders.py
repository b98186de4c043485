"""Finds the running programs of this installation that the installer could not close.

Before it closes anything: an agent that is ended for an upgrade that then fails has lost its
recording for nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

import psutil

from biosensor_common.errors import ConfigError
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.page.instance import LOCK_FILE, page_folder
from biosensor_gateway.recording.recorder.local import LocalRecorder

_PROGRAMS = frozenset({"biosensor-gateway.exe", "biosensor gateway.exe"})
_OF_PAGE = frozenset({"page", "play-recording"})
_OF_RECORDING = frozenset({"keep-recording", "record-streams"})
_OF_AGENT = frozenset({"run", "send-features"})


@dataclass(frozen=True, slots=True)
class Program:
    """A process of one of our programs.

    Attributes
    ----------
    user
        Empty if the system does not tell.
    words
        Its command line; empty if the system does not tell.
    family
        Numbers of the processes that it was started by or has started, and its own; also of those
        that the same agent's keeper has started.
    """

    number: int
    user: str
    words: tuple[str, ...]
    family: frozenset[int]


@dataclass(frozen=True, slots=True)
class Closing:
    """What the commands of one user can close.

    Attributes
    ----------
    agent
        Process of the agent; None if none runs.
    page, recording
        Whether it goes on.
    """

    user: str
    agent: int | None
    page: bool
    recording: bool

    def closes(self, program: Program) -> bool:
        """Whether `record stop`, `page --end` or `stop` end this one."""
        if program.user != self.user or not program.words:
            return False
        first = program.words[1] if len(program.words) > 1 else ""
        if first in _OF_AGENT:
            return self.agent in program.family
        if first in _OF_RECORDING:
            return self.recording
        # Without words it is the program that opens the page.
        return (not first or first in _OF_PAGE) and self.page and "--lsl" not in program.words


def what_cannot_be_closed(state: Path) -> list[str]:
    """Name each program that runs and that its installer cannot close; for a person."""
    own = psutil.Process()
    beside = {own.pid, *(each.pid for each in own.parents())}
    closing = Closing(
        own.username(),
        _agent(state),
        is_held(page_folder(state), LOCK_FILE),
        LocalRecorder(state).is_running,
    )
    programs = [each for each in _programs() if each.number not in beside]
    return [sentence(each) for each in programs if not closing.closes(each)]


def sentence(program: Program) -> str:
    """Say which program it is."""
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
        if _name(process, words).lower() in _PROGRAMS:
            yield Program(process.pid, _user(process), words, frozenset(_family(process)))


def _words(process: psutil.Process) -> tuple[str, ...]:
    try:
        return tuple(process.cmdline())
    except (psutil.Error, OSError):
        return ()


def _name(process: psutil.Process, words: Sequence[str]) -> str:
    try:
        return process.name()
    except (psutil.Error, OSError):
        return PureWindowsPath(words[0]).name if words else ""


def _user(process: psutil.Process) -> str:
    try:
        return process.username()
    except (psutil.Error, OSError):
        return ""


def _family(process: psutil.Process) -> Iterator[int]:
    yield process.pid
    try:
        for parent in process.parents():
            yield parent.pid
            # A standby is started by the same keeper as the agent.
            if _words(parent)[1:2] == ("run",):
                yield from (each.pid for each in parent.children())
        yield from (each.pid for each in process.children(recursive=True))
    except (psutil.Error, OSError):
        return
