"""A Windows PC of a lab: a copy of the build's Wine prefix, without the program at first."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Self

from installer.layout import BIN, PROGRAM, WINDOWED, WORK
from installer.wine.prefix import Prefix, WineError

NAME = "Biosensor Gateway"
UNINSTALL_KEY = rf"HKLM\Software\Microsoft\Windows\CurrentVersion\Uninstall\{PROGRAM}"
# What programs write into pipes in a Western European Windows.
PIPE_ENCODING = "cp1252"
# As on any PC: folders of its own user, whatever is chosen on the host, and names in Unicode.
_ORDINARY = {
    "BIOSENSOR_GATEWAY_SETTINGS": "",
    "BIOSENSOR_GATEWAY_STATE": "",
    "LC_ALL": "C.UTF-8",
}
_ATTEMPTS = 3
_SETTING = re.compile(r"^    (?P<name>.+?)    (?P<kind>REG_\w+)    (?P<value>.*)$", re.MULTILINE)


class WindowsPc:
    """One PC; a context manager. Leaving it ends all its programs.

    Parameters
    ----------
    folder
        Where its disk is made; must not exist.
    environment
        More variables for all its programs.
    before
        Words before each command, as `tests.rigs.hosts.lan.Host.command` has them, which
        lead to where its programs and their sockets are to be.
    """

    def __init__(
        self,
        folder: Path,
        environment: Mapping[str, str] | None = None,
        before: tuple[str, ...] = (),
    ) -> None:
        self.prefix = Prefix(folder, {**_ORDINARY, **(environment or {})}, before)

    def __enter__(self) -> Self:
        made = WORK / "prefix"
        # Nothing writes into the files of Windows itself, so that they can be shared.
        shutil.copytree(made, self.prefix.folder, symlinks=True, copy_function=_link_or_copy)
        self._switch_on()
        return self

    def __exit__(self, *_: object) -> None:
        self.prefix.end()
        shutil.rmtree(self.prefix.folder, ignore_errors=True)

    def _switch_on(self) -> None:
        # Right after the server of another Windows has ended, the first program fails at times.
        for _ in range(_ATTEMPTS):
            if self.prefix.attempt("cmd", "/c", "exit").returncode == 0:
                self.prefix.settle()
                return
            self.prefix.end()
        shutil.rmtree(self.prefix.folder, ignore_errors=True)
        raise WineError(f"{self.prefix.folder}: no program starts")

    # ---- what is on its disk -----------------------------------------------------------

    @property
    def drive_c(self) -> Path:
        """Its disk, as the host sees it."""
        return self.prefix.drive_c

    @property
    def program_folder(self) -> Path:
        """Where the program is installed by default."""
        return self.drive_c / "Program Files" / NAME

    @property
    def program(self) -> Path:
        """The installed program."""
        return self.program_folder / BIN / f"{PROGRAM}.exe"

    @property
    def windowed(self) -> Path:
        """The installed program without a console, which the Start menu opens."""
        return self.program.with_name(f"{WINDOWED}.exe")

    @property
    def user_folder(self) -> Path:
        """Where settings, status and logs of its user are."""
        (user,) = (each for each in (self.drive_c / "users").iterdir() if each.name != "Public")
        return user / "AppData" / "Local" / PROGRAM

    def files(self) -> set[str]:
        """All files on its disk, as paths below ``C:``."""
        return {
            str(each.relative_to(self.drive_c))
            for each in self.drive_c.rglob("*")
            if not each.is_dir()
        }

    # ---- what runs on it ---------------------------------------------------------------

    def install(self, setup: Path, *options: str) -> subprocess.CompletedProcess[str]:
        """Run an installer silently and wait for all that it starts."""
        ended = self.prefix.attempt(setup, "/S", *options)
        self.prefix.settle()
        return ended

    def uninstall(self, *options: str) -> None:
        """Run the uninstaller silently and wait until it is done."""
        # It copies itself elsewhere, starts the copy and ends at once.
        self.prefix.attempt(self.program_folder / "uninstall.exe", "/S", *options)
        self.prefix.settle()

    def gateway(self, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
        """Run a command of the installed program to its end."""
        return self.prefix.attempt(self.program, *arguments, encoding=PIPE_ENCODING)

    def registry(self, key: str) -> dict[str, str] | None:
        """Values of a registry key, None if there is no such key."""
        ended = self.prefix.attempt("reg", "query", key)
        if ended.returncode:
            return None
        found = _SETTING.finditer(ended.stdout.replace("\r", ""))
        return {each["name"]: each["value"] for each in found}

    def plug_in(self, com: int, terminal: str | Path) -> None:
        """Let a pseudo-terminal of the host be the port ``COM<com>``."""
        self.unplug(com)
        self._device(com).symlink_to(terminal)

    def unplug(self, com: int) -> None:
        """Let the port vanish; whoever has it open keeps what is behind it."""
        self._device(com).unlink(missing_ok=True)

    def _device(self, com: int) -> Path:
        return self.prefix.folder / "dosdevices" / f"com{com}"


def _link_or_copy(source: str, target: str) -> None:
    # The registry's files are replaced as a whole, but only by the server of this Wine.
    if source.endswith(".reg"):
        shutil.copy2(source, target)
        return
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
