"""Programs that somebody put into the folder in which a terminal is."""

from __future__ import annotations

import pytest

from tests.rigs.windows.pc import WindowsPc

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]

# All that the checks of Windows ever asked, as files that a search by name takes for them.
NAMES = ("sc", "netsh", "powercfg", "cmd", "powershell", "notepad")


def test_doctor_starts_none_of_them(installed: WindowsPc) -> None:
    folder = installed.drive_c / "study"
    folder.mkdir()
    for name in NAMES:
        (folder / f"{name}.bat").write_text("@echo planted> C:\\study\\ran.txt\r\n")
    go = f'cd /d C:\\study && "C:\\Program Files\\{installed.program_folder.name}'
    checks = " ".join(f"--only {each}" for each in ("clock", "windows_firewall", "power"))
    (installed.drive_c / "go.bat").write_text(f'@{go}\\{installed.program.name}" doctor {checks}')
    ended = installed.prefix.attempt("cmd", "/c", r"C:\go.bat")
    assert "the Windows time service" in ended.stdout
    assert not (folder / "ran.txt").exists()
