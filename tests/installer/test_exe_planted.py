"""Programs that somebody put into the folder in which a terminal is."""

from __future__ import annotations

import pytest

from installer.layout import PROGRAM
from tests.rigs.windows.desktop import BIN_FOLDER
from tests.rigs.windows.pc import WindowsPc

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]

# All that the checks of Windows ever asked, as files that a search by name takes for them.
NAMES = ("sc", "netsh", "powercfg", "cmd", "powershell", "notepad")


def test_doctor_starts_none_of_them(installed: WindowsPc) -> None:
    folder = installed.drive_c / "study"
    folder.mkdir()
    for name in NAMES:
        (folder / f"{name}.bat").write_text("@echo planted> C:\\study\\ran.txt\r\n")
    checks = " ".join(f"--only {each}" for each in ("clock", "windows_firewall", "power"))
    command = f'"{BIN_FOLDER}\\{PROGRAM}.exe" doctor {checks}'
    (installed.drive_c / "go.bat").write_text(f"@cd /d C:\\study && {command}")
    ended = installed.prefix.attempt("cmd", "/c", r"C:\go.bat")
    assert "the Windows time service" in ended.stdout
    assert not (folder / "ran.txt").exists()
