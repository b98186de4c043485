"""Adds a folder to the search path of all users of a Windows PC, and removes it.

App Paths, where programs register, serves the Run dialog and ``start``; a terminal looks
into PATH alone. NSIS itself would cut a PATH of more than 1023 characters.
"""

from __future__ import annotations

import sys

_KEY = r"SYSTEM\CurrentControlSet\Control\Session Manager\Environment"
_BROADCAST, _SETTING_CHANGE, _ABORT_IF_HUNG = 0xFFFF, 0x001A, 0x0002
_BROADCAST_TIMEOUT_MS = 2000


def with_folder(path: str, folder: str) -> str:
    """Return a search path with *folder* as its last entry, unless it has it already.

    `without_folder` leads back to what was there before, semicolons at its end included.

    Raises
    ------
    ValueError
        The folder's name has a semicolon, which separates the entries.
    """
    if ";" in folder:
        raise ValueError(f"the folder {folder} has a semicolon in its name")
    if not path:
        return folder
    entries = path.split(";")
    if any(_same(entry, folder) for entry in entries):
        return path
    entries.insert(len(entries) if entries[-1] else -1, folder)
    return ";".join(entries)


def without_folder(path: str, folder: str) -> str:
    """Return a search path without *folder*; all else stays as it is."""
    return ";".join(entry for entry in path.split(";") if not _same(entry, folder))


def _same(one: str, other: str) -> bool:
    return _plain(one) == _plain(other)


def _plain(entry: str) -> str:
    """Return an entry without what makes no difference: case, quotes, a backslash at its end."""
    return entry.strip().strip('"').rstrip("\\").lower()


def add_to_path(folder: str) -> None:
    """Add a folder to the PATH of all users; see `with_folder`.

    Raises
    ------
    OSError
        The registry cannot be written: no administrator.
    ValueError
        As for `with_folder`.
    """
    _edit(folder, present=True)


def remove_from_path(folder: str) -> None:
    """Remove a folder from the PATH of all users.

    Raises
    ------
    OSError
        The registry cannot be written.
    """
    _edit(folder, present=False)


if sys.platform == "win32":
    import ctypes
    import winreg

    def _edit(folder: str, *, present: bool) -> None:
        access = winreg.KEY_READ | winreg.KEY_WRITE | winreg.KEY_WOW64_64KEY
        with winreg.OpenKey(winreg.HKEY_LOCAL_MACHINE, _KEY, 0, access) as key:
            path, kind = winreg.QueryValueEx(key, "Path")
            changed = (with_folder if present else without_folder)(path, folder)
            if changed == path:
                return
            # It may hold %SystemRoot%: its kind stays what it was.
            winreg.SetValueEx(key, "Path", 0, kind, changed)
        _announce()

    def _announce() -> None:
        """Tell the programs that run, the desktop first of all, so that new terminals know."""
        ctypes.windll.user32.SendMessageTimeoutW(
            *(_BROADCAST, _SETTING_CHANGE, 0, ctypes.c_wchar_p("Environment")),
            *(_ABORT_IF_HUNG, _BROADCAST_TIMEOUT_MS, None),
        )

else:

    def _edit(folder: str, *, present: bool) -> None:
        del folder, present
        raise OSError("only Windows keeps the PATH of its users in a registry")
