r"""Opens an address in a separate window, or in the browser.

A program is started by its full path, because the current folder may contain another program of
the same name. Source for ``App Paths`` and the folders of programs: Microsoft's documentation
"Application Registration"; for ``--app``: Chromium's list of switches.
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
"""A browser that cannot show a window, for example without a screen, has ended by then."""

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
        Address of a page on this computer.
    in_window
        Whether to try a window without tabs and bars first.
    """
    return (in_window and _open_window(address)) or webbrowser.open(address)


def _open_window(address: str) -> bool:
    # Not the default browser, which may lack such windows. A browser that was never used would
    # show a tour before the page.
    options = [f"--app={address}", "--no-first-run"]
    return any(_started([program, *options]) for program in _programs())


def _started(command: list[str]) -> bool:
    """Whether a browser has started, or passed the address to one that runs already."""
    try:
        # In a new session, so that neither Ctrl-C nor the end of this program closes it.
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
        r"""Yield the paths of Edge: as it is registered, and where Windows installs it."""
        registered = _value(rf"{_WINDOWS}\App Paths\{_EDGE}", "").strip('"')
        folders = (_value(_WINDOWS, each) for each in _FOLDERS)
        usual = (str(Path(each, "Microsoft", "Edge", "Application", _EDGE)) for each in folders)
        for program in dict.fromkeys((registered, *usual)):
            if Path(program).is_absolute() and Path(program).is_file():
                yield program

    def _value(key: str, name: str) -> str:
        # The machine's registry only, which a user without administrator rights cannot change.
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
    """Yield the paths of browsers in macOS's folders of applications."""
    for name in _MAC_CHROMIUMS:
        for folder in folders:
            program = folder / f"{name}.app" / "Contents" / "MacOS" / name
            if program.is_file():
                yield str(program)
