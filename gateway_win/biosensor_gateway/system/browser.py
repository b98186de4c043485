r"""Opens an address in a window of its own, or in the browser.

A program is started by its full path, never by its name alone: the current folder may hold one
that somebody else put there. Source for ``App Paths`` and the folders of programs: Microsoft's
documentation "Application Registration"; for ``--app``: Chromium's list of switches.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
import webbrowser
from collections.abc import Iterable, Iterator
from pathlib import Path

from biosensor_common.system_programs import full_path

_SHOWN_AFTER_S = 2.0
"""One that cannot show a window, for want of a screen, say, has ended by then."""

_CHROMIUMS = (
    *("chromium", "chromium-browser", "google-chrome", "google-chrome-stable"),
    "microsoft-edge",
)
_MAC_CHROMIUMS = ("Google Chrome", "Microsoft Edge", "Chromium", "Brave Browser")


def open_page(address: str, *, in_window: bool) -> bool:
    """Open an address; return whether that was possible. May take `_SHOWN_AFTER_S`.

    Parameters
    ----------
    address
        Of a page on this computer.
    in_window
        Try first to give it a window without tabs and bars, as a program has one.
    """
    return (in_window and _open_window(address)) or webbrowser.open(address)


def _open_window(address: str) -> bool:
    # What has the browser that a person chose as the usual one may not know such windows.
    # One that was never used would show a tour before the page.
    options = [f"--app={address}", "--no-first-run"]
    return any(_started([program, *options]) for program in _programs())


def _started(command: list[str]) -> bool:
    """Whether a browser has begun, or handed the address to one that runs."""
    try:
        # Neither Ctrl-C here nor the end of this program is meant for it.
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
    except OSError:
        return False
    with contextlib.suppress(subprocess.TimeoutExpired):
        return process.wait(_SHOWN_AFTER_S) == 0
    return True


if sys.platform == "win32":
    import winreg

    _EDGE = "msedge.exe"
    _WINDOWS = r"SOFTWARE\Microsoft\Windows\CurrentVersion"
    _FOLDERS = ("ProgramFilesDir (x86)", "ProgramFilesDir")

    def _programs() -> Iterator[str]:
        r"""Yield where Edge is: as it says itself, and where Windows brings it."""
        said = _value(rf"{_WINDOWS}\App Paths\{_EDGE}", "").strip('"')
        folders = (_value(_WINDOWS, each) for each in _FOLDERS)
        usual = (str(Path(each, "Microsoft", "Edge", "Application", _EDGE)) for each in folders)
        for program in dict.fromkeys((said, *usual)):
            if Path(program).is_absolute() and Path(program).is_file():
                yield program

    def _value(key: str, name: str) -> str:
        # Of all users: what one of them has set is not asked.
        access = winreg.KEY_READ | winreg.KEY_WOW64_64KEY
        try:
            with winreg.OpenKey(winreg.HKEY_LOCAL_MACHINE, key, 0, access) as opened:
                return str(winreg.QueryValueEx(opened, name)[0])
        except OSError:
            return ""

elif sys.platform == "darwin":

    def _programs() -> Iterator[str]:
        return apps((Path("/Applications"), Path.home() / "Applications"))

else:

    def _programs() -> Iterator[str]:
        found = (full_path(name) for name in _CHROMIUMS)
        yield from (program for program in found if program is not None)


def apps(folders: Iterable[Path]) -> Iterator[str]:
    """Yield the programs of browsers that macOS has in its folders of applications."""
    for name in _MAC_CHROMIUMS:
        for folder in folders:
            program = folder / f"{name}.app" / "Contents" / "MacOS" / name
            if program.is_file():
                yield str(program)
