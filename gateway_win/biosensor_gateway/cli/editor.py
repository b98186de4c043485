"""Opens a text file in the user's editor."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from biosensor_common.errors import ConfigError, ConfigReason


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
        _run(["open", "-t", str(path)], path)
    elif editor := os.environ.get("VISUAL") or os.environ.get("EDITOR"):
        _run([*_words(editor, path), str(path)], path)
    elif shutil.which("xdg-open"):
        _run(["xdg-open", str(path)], path)
    else:
        message = f"no editor was found; set EDITOR to yours, or open {path} by hand"
        raise ConfigError(ConfigReason.NOT_FOUND, message)


if sys.platform == "win32":

    def _open_on_windows(path: Path) -> None:
        try:
            os.startfile(path)  # noqa: S606 - that is its purpose
        except OSError:
            # No program is known for the file's ending.
            notepad = str(Path(os.environ.get("SYSTEMROOT", r"C:\Windows"), "notepad.exe"))
            try:
                subprocess.Popen([notepad, path])  # noqa: S603 - no shell
            except OSError as error:
                raise _failed(notepad, path, error.strerror or str(error)) from error


def _words(editor: str, path: Path) -> list[str]:
    try:
        return shlex.split(editor)
    except ValueError as error:
        raise _failed(editor, path, str(error)) from error


def _run(command: Sequence[str], path: Path) -> None:
    try:
        code = subprocess.run(command, check=False).returncode  # noqa: S603 - the user's own
    except OSError as error:
        raise _failed(command[0], path, error.strerror or str(error)) from error
    if code:
        raise _failed(command[0], path, f"exit code {code}")


def _failed(editor: str, path: Path, why: str) -> ConfigError:
    message = f"the editor {editor} could not open {path}: {why}; open the file by hand"
    return ConfigError(ConfigReason.UNREADABLE, message)
