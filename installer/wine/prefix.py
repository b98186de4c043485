"""A Wine prefix, and programs that run in it."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from biosensor_common.process_limits import raise_limit
from installer.layout import PROGRAM, WINDOWED
from installer.wine.forwarder import forwarding_dll

_QUIET = {
    "WINEARCH": "win64",
    "WINEDEBUG": "-all",
    # Neither .NET nor a browser; no WMI, where Wine's ends a Python 3.13 that looks there for
    # its version of Windows; and no menu entries in the home folder of the host.
    "WINEDLLOVERRIDES": "mscoree,mshtml,wbemprox=;winemenubuilder.exe=d",
}
_OVERRIDES = r"HKCU\Software\Wine\DllOverrides"
_OF_PROGRAM = r"HKCU\Software\Wine\AppDefaults\{}\DllOverrides"
_PROGRAMS = (f"{PROGRAM}.exe", f"{WINDOWED}.exe", "LabRecorderCLI.exe")
_CPP_RUNTIME = ("msvcp140", "vcruntime140", "vcruntime140_1")
"""A fresh Windows has none of them."""


class WineError(RuntimeError):
    """A program under Wine failed; the text has what it said."""


@dataclass(frozen=True, slots=True)
class Prefix:
    """One virtual Windows."""

    folder: Path  # `WINEPREFIX`.
    # More variables for all its programs.
    environment: Mapping[str, str] = field(default_factory=dict[str, str])
    before: tuple[str, ...] = ()  # Words before each command, which lead to where it is to run.

    @property
    def variables(self) -> dict[str, str]:
        """The whole environment of its programs."""
        host = {key: value for key, value in os.environ.items() if key != "DISPLAY"}
        return {**host, **_QUIET, "WINEPREFIX": str(self.folder), **self.environment}

    @property
    def drive_c(self) -> Path:
        r"""What Windows calls ``C:\``."""
        return self.folder / "drive_c"

    def run(self, *command: str | Path, timeout: float = 300.0) -> str:
        """Run a program to its end and return what it said.

        Raises
        ------
        WineError
            If it fails.
        """
        ended = self.attempt(*command, timeout=timeout)
        if ended.returncode:
            shown = " ".join(map(str, command))
            raise WineError(f"{shown}: exit code {ended.returncode}\n{ended.stdout}")
        return ended.stdout

    def attempt(
        self, *command: str | Path, timeout: float = 300.0, encoding: str = "utf-8"
    ) -> subprocess.CompletedProcess[str]:
        """Run a program to its end, whatever comes of it; its stderr is in its stdout."""
        # Windows Pythons die under Wine when stdout is a file, so there are pipes here.
        return subprocess.run(
            self._line("wine", *command),
            env=self.variables,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding=encoding,
            errors="replace",
            timeout=timeout,
            check=False,
        )

    def start(self, *command: str | Path) -> subprocess.Popen[bytes]:
        """Start a program with pipes; the caller reads them and ends it."""
        return subprocess.Popen(
            self._line("wine", *command),
            env=self.variables,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )

    def settle(self) -> None:
        """Wait until all its programs have ended and the registry is on disk."""
        self._server("-w")

    def end(self) -> None:
        """End all its programs, and with them the server that owns their sockets."""
        self._server("-k")
        self.settle()

    def _server(self, option: str) -> None:
        line = self._line("wineserver", option)
        subprocess.run(line, env=self.variables, check=False, timeout=120)

    def _line(self, *words: str | Path) -> list[str]:
        # One server opens the files of all programs here: over a thousand with all virtual sensors.
        raise_limit()
        return [*self.before, *map(str, words)]


def windows_path(path: Path) -> str:
    """Name a file of the host as Windows programs under Wine do."""
    return "Z:" + str(path.resolve()).replace("/", "\\")


def make_prefix(folder: Path, ucrtbase: bytes) -> Prefix:
    """Make a fresh Windows 10 in which a current CPython and numpy run.

    Wine 8 lacks two things that they need; neither is ever shipped:
    functions of the C runtime, so Microsoft's own ``ucrtbase.dll`` goes in, and
    ``bcryptprimitives.dll``, of which Rust programs need one function that Wine has
    under an older name.

    The programs that are shipped get no library of C++ but the one that they bring: Wine would
    take its own in place of that, for which LabRecorder's program is too new (it takes a mutex
    that was never initialised for one that was), so that it crashed or hung.
    """
    prefix = Prefix(folder)
    prefix.run("wineboot", "-i")
    prefix.run("winecfg", "-v", "win10")
    prefix.settle()
    system = prefix.drive_c / "windows" / "system32"
    (system / "ucrtbase.dll").write_bytes(ucrtbase)
    random = forwarding_dll("bcryptprimitives.dll", {"ProcessPrng": "advapi32.SystemFunction036"})
    (system / "bcryptprimitives.dll").write_bytes(random)
    prefix.run("reg", "add", _OVERRIDES, "/v", "ucrtbase", "/d", "native,builtin", "/f")
    for program in _PROGRAMS:
        for library in _CPP_RUNTIME:
            key = _OF_PROGRAM.format(program)
            prefix.run("reg", "add", key, "/v", library, "/d", "native", "/f")
    prefix.settle()
    return prefix
