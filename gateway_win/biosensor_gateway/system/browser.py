r"""Opens an address in a separate window, or in the browser.

A program is started by its full path, because the current folder may contain another program of
the same name. On Linux and macOS other users can read command lines, and the address of a page
contains a token. So browsers are given the path of a private file there, which redirects to the
address and is removed once the token is used. Windows shows command lines to their own user only.
Source for ``App Paths`` and the folders of programs: Microsoft's documentation "Application
Registration"; for ``--app``: Chromium's list of switches; for what browsers of snapd may read: its
documentation of the interface "home".
"""

from __future__ import annotations

import contextlib
import html
import os
import secrets
import subprocess
import sys
import tempfile
import webbrowser
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from biosensor_common.child import full_path

_SHOWN_AFTER_S = 2.0
"""A browser that cannot show a window, for example without a screen, has ended by then."""

_SNAPS = ("/snap/bin", "/var/lib/snapd/snap/bin")
_REDIRECT = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<meta name="referrer" content="no-referrer">
<meta http-equiv="refresh" content="0;url={0}">
<title>Biosensor Gateway</title>
<p><a href="{0}">Open the page</a></p>
</html>
"""

_CHROMIUMS = (
    *("chromium", "chromium-browser", "google-chrome", "google-chrome-stable"),
    "microsoft-edge",
)
_MAC_CHROMIUMS = ("Google Chrome", "Microsoft Edge", "Chromium", "Brave Browser")


class WayIn(NamedTuple):
    """An address of a page on this computer that opens it once."""

    address: str
    # Path at which `open_page` creates a file that redirects to the address, in a folder of its
    # own; empty where command lines are private. Whoever serves the page removes the folder.
    redirect: str


def way_in(address: str) -> WayIn:
    """Return a way in with an unused path for its file."""
    if sys.platform == "win32":
        return WayIn(address, "")
    folder = _readable_folder() / f"biosensor-gateway-{secrets.token_hex(8)}"
    return WayIn(address, str(folder / "open.html"))


def _readable_folder() -> Path:
    """Return a folder from which browsers may open files."""
    # snapd lets its browsers read neither /run and /tmp nor hidden folders in the home folder.
    if any(Path(each).is_dir() for each in _SNAPS):
        with contextlib.suppress(RuntimeError):
            return Path.home()
    # Has room even if the disk is full.
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    return Path(runtime if os.path.isdir(runtime) else tempfile.gettempdir())  # noqa: PTH112


def open_page(way: WayIn, *, in_window: bool) -> bool:
    """Open a page; return whether that was possible. May take `_SHOWN_AFTER_S`.

    Parameters
    ----------
    in_window
        Whether to try a window without tabs and bars first.
    """
    address = way.address
    if way.redirect:
        try:
            address = _written(Path(way.redirect), address).as_uri()
        except OSError:
            return False
    return (in_window and _open_window(address)) or webbrowser.open(address)


def _written(file: Path, address: str) -> Path:
    """Write a file that redirects to an address; only the user can read it."""
    file.parent.mkdir(0o700)
    handle = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "w", encoding="utf-8") as opened:
        opened.write(_REDIRECT.format(html.escape(address)))
    return file


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
