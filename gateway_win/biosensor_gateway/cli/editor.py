"""Opens a text file in the user's editor."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.system_programs import full_path

if sys.platform == "win32":
    from biosensor_common.system_programs import windows_folder


def open_in_editor(path: Path) -> None:
    """Open a file in the editor that the user has chosen for text.

    Windows: the program for the file's ending, else Notepad; neither is waited for.
    macOS: the text editor. Elsewhere ``$VISUAL`` or ``$EDITOR``, which may need the
    terminal and is waited for, else ``xdg-open``.

    Raises
    ------
    ConfigError
        ``NOT_FOUND`` if there is no editor, ``UNREADABLE`` if it failed.
    """
    if sys.platform == "win32":
        _open_on_windows(path)
    elif sys.platform == "darwin":
        _run(["open", "-t"], path)
    elif editor := os.environ.get("VISUAL") or os.environ.get("EDITOR"):
        _run(_words(editor, path), path)
    elif full_path("xdg-open"):
        _run(["xdg-open"], path)
    else:
        message = f"no editor was found; set EDITOR to yours, or open {path} by hand"
        raise ConfigError(ConfigReason.NOT_FOUND, message)


if sys.platform == "win32":

    def _open_on_windows(path: Path) -> None:
        try:
            os.startfile(path)  # noqa: S606 - that is its purpose
        except OSError:
            # No program is known for the file's ending.
            notepad = str(windows_folder(system=False) / "notepad.exe")
            try:
                subprocess.Popen([notepad, path])
            except OSError as error:
                raise _failed(notepad, path, error.strerror or str(error)) from error


def _words(editor: str, path: Path) -> list[str]:
    try:
        return shlex.split(editor)
    except ValueError as error:
        raise _failed(editor, path, str(error)) from error


def _run(command: Sequence[str], path: Path) -> None:
    name, *options = command or [""]
    program = name if "/" in name else full_path(name)
    if program is None:
        raise _failed(name, path, "no folder of PATH has it")
    try:
        code = subprocess.run([program, *options, path], check=False).returncode
    except OSError as error:
        raise _failed(name, path, error.strerror or str(error)) from error
    if code:
        raise _failed(name, path, f"exit code {code}")


def _failed(editor: str, path: Path, why: str) -> ConfigError:
    message = f"the editor {editor} could not open {path}: {why}; open the file by hand"
    return ConfigError(ConfigReason.UNREADABLE, message)
