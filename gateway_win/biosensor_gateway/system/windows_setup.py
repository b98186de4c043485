"""Changes the registry for the Windows installer: start at logon, and the PATH.

An installer runs as the administrator who allowed it, who is often another person than the user of
the session. The entry for the start at logon goes into the registry of the session's user.
"""

from __future__ import annotations

import sys

ENTRY = "Biosensor Gateway"
_RUN = r"Software\Microsoft\Windows\CurrentVersion\Run"


class NoUserError(OSError):
    """Nobody is logged on in the session, as when a service runs the installer."""


if sys.platform == "win32":
    import ctypes
    import winreg
    from collections.abc import Iterator

    # Constants of wtsapi32.h.
    _THIS_SERVER, _THIS_SESSION, _USER_NAME, _DOMAIN_NAME = None, -1, 5, 7
    _SID_BYTES, _NAME_CHARACTERS = 68, 256
    _ACCESS = winreg.KEY_READ | winreg.KEY_WRITE | winreg.KEY_WOW64_64KEY

    def user_of_session() -> str:
        """Return the security identifier (SID) of the user who is logged on in this session.

        Raises
        ------
        NoUserError
            If there is none, or Windows does not report it.
        """
        name = _of_session(_USER_NAME)
        if not name:
            raise NoUserError("no user is logged on in this session")
        domain = _of_session(_DOMAIN_NAME)
        return _sid(f"{domain}\\{name}" if domain else name)

    def choose(command: str, *, wanted: bool) -> None:
        """Write or remove the entry of the session's user; update the entries of other users.

        Raises
        ------
        OSError
            If the registry cannot be written; `NoUserError` if nobody is logged on.
        """
        own = user_of_session()
        for user in _users():
            if wanted if user == own else _has(user):
                with winreg.CreateKeyEx(winreg.HKEY_USERS, rf"{user}\{_RUN}", 0, _ACCESS) as key:
                    winreg.SetValueEx(key, ENTRY, 0, winreg.REG_SZ, command)
            elif user == own:
                _remove(user)

    def is_chosen() -> bool:
        """Whether the session's user has the entry."""
        try:
            return _has(user_of_session())
        except NoUserError:
            return False

    def remove_all() -> None:
        """Remove the entries of all users who are logged on."""
        for user in _users():
            _remove(user)

    def _of_session(what: int) -> str:
        text, size = ctypes.c_wchar_p(), ctypes.c_uint32()
        library = ctypes.WinDLL("wtsapi32")
        if not library.WTSQuerySessionInformationW(
            _THIS_SERVER, _THIS_SESSION, what, ctypes.byref(text), ctypes.byref(size)
        ):
            return ""
        found = text.value or ""
        library.WTSFreeMemory(text)
        return found

    def _sid(account: str) -> str:
        sid, size = ctypes.create_string_buffer(_SID_BYTES), ctypes.c_uint32(_SID_BYTES)
        domain = ctypes.create_unicode_buffer(_NAME_CHARACTERS)
        length, kind = ctypes.c_uint32(_NAME_CHARACTERS), ctypes.c_uint32()
        library = ctypes.WinDLL("advapi32")
        if not library.LookupAccountNameW(
            *(None, account, sid, ctypes.byref(size)),
            *(domain, ctypes.byref(length), ctypes.byref(kind)),
        ):
            raise NoUserError(f"Windows does not know the account {account}")
        text = ctypes.c_wchar_p()
        if not library.ConvertSidToStringSidW(sid, ctypes.byref(text)):
            raise NoUserError(f"Windows does not give the identifier of {account}")
        found = text.value or ""
        ctypes.WinDLL("kernel32").LocalFree(text)
        return found

    def _users() -> Iterator[str]:
        count = winreg.QueryInfoKey(winreg.HKEY_USERS)[0]
        for name in [winreg.EnumKey(winreg.HKEY_USERS, each) for each in range(count)]:
            # The other keys are the template for new users, and the users' file associations.
            if name.startswith("S-1-") and not name.endswith("_Classes"):
                yield name

    def _has(user: str) -> bool:
        try:
            with winreg.OpenKey(winreg.HKEY_USERS, rf"{user}\{_RUN}") as key:
                winreg.QueryValueEx(key, ENTRY)
        except FileNotFoundError:
            return False
        return True

    def _remove(user: str) -> None:
        if _has(user):
            with winreg.OpenKey(winreg.HKEY_USERS, rf"{user}\{_RUN}", 0, _ACCESS) as key:
                winreg.DeleteValue(key, ENTRY)

else:
    _REFUSED = "only Windows has a registry of programs that start at logon"

    def user_of_session() -> str:
        """Refuse: only Windows has such users."""
        raise NoUserError(_REFUSED)

    def choose(command: str, *, wanted: bool) -> None:
        """Refuse: only Windows has such entries."""
        del command, wanted
        raise NoUserError(_REFUSED)

    def is_chosen() -> bool:
        """Return False: only Windows has such entries."""
        return False

    def remove_all() -> None:
        """Remove nothing: only Windows has such entries."""


_KEY = r"SYSTEM\CurrentControlSet\Control\Session Manager\Environment"
_BROADCAST, _SETTING_CHANGE, _ABORT_IF_HUNG = 0xFFFF, 0x001A, 0x0002
_BROADCAST_TIMEOUT_MS = 2000


def with_folder(path: str, folder: str) -> str:
    """Return a search path with *folder* as its last entry, unless it has it already.

    `without_folder` restores the path as it was, with any semicolon at its end.

    Raises
    ------
    ValueError
        If the folder's name has a semicolon, which separates the entries.
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
    """Normalize an entry: case, quotes and a backslash at the end make no difference."""
    return entry.strip().strip('"').rstrip("\\").lower()


def add_to_path(folder: str) -> None:
    """Add a folder to the PATH of all users; see `with_folder`.

    Raises
    ------
    OSError
        If the registry cannot be written, as without administrator rights.
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
            # With its type unchanged, because the value may contain %SystemRoot%.
            winreg.SetValueEx(key, "Path", 0, kind, changed)
        _announce()

    def _announce() -> None:
        """Notify running programs, above all the desktop, from which new terminals inherit."""
        ctypes.windll.user32.SendMessageTimeoutW(
            *(_BROADCAST, _SETTING_CHANGE, 0, ctypes.c_wchar_p("Environment")),
            *(_ABORT_IF_HUNG, _BROADCAST_TIMEOUT_MS, None),
        )

else:

    def _edit(folder: str, *, present: bool) -> None:
        del folder, present
        raise OSError("only Windows keeps users' PATH in a registry")
