"""Whose registry gets what starts at logon, when somebody else has allowed the installation."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from installer.layout import WORK
from installer.wine.prefix import windows_path
from tests.rigs.windows.pc import NAME, WindowsPc

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]

# As in a process that another account has elevated: HKEY_CURRENT_USER is that one's.
SCRIPT = r"""
import ctypes, json, winreg
from biosensor_gateway.system import windows_setup as autostart

RUN = r"Software\Microsoft\Windows\CurrentVersion\Run"
USER = autostart.user_of_session()
COLLEAGUE, VISITOR = "S-1-5-21-1-2-3-1001", "S-1-5-21-1-2-3-1002"

def entries():
    found = {}
    for user in (USER, COLLEAGUE, VISITOR, "administrator"):
        root = winreg.HKEY_CURRENT_USER if user == "administrator" else winreg.HKEY_USERS
        path = RUN if user == "administrator" else user + "\\" + RUN
        try:
            with winreg.OpenKey(root, path) as key:
                found[user] = winreg.QueryValueEx(key, autostart.ENTRY)[0]
        except FileNotFoundError:
            found[user] = None
    return list(found.values()) + [autostart.is_chosen()]

administrator = winreg.CreateKey(winreg.HKEY_LOCAL_MACHINE, r"Software\of the administrator")
override = ctypes.WinDLL("advapi32").RegOverridePredefKey
handles = winreg.HKEY_CURRENT_USER, int(administrator)
assert not override(*map(ctypes.c_void_p, handles))
for user in (COLLEAGUE, VISITOR):
    winreg.CreateKey(winreg.HKEY_USERS, user + "\\" + RUN)
with winreg.OpenKey(winreg.HKEY_USERS, COLLEAGUE + "\\" + RUN, 0, winreg.KEY_WRITE) as key:
    winreg.SetValueEx(key, autostart.ENTRY, 0, winreg.REG_SZ, "old")

seen = [entries()]
autostart.choose("new", wanted=True)
seen.append(entries())
autostart.choose("newer", wanted=False)
seen.append(entries())
autostart.remove_all()
seen.append(entries())
print(json.dumps({"entry": autostart.ENTRY, "seen": seen}))
"""


def test_it_is_the_user_of_the_session_and_others_keep_their_choice(
    installed: WindowsPc, tmp_path: Path
) -> None:
    script = tmp_path / "as_administrator.py"
    script.write_text(SCRIPT)
    paths = ";".join(windows_path(WORK / each) for each in ("product", "packages"))
    environment = {**installed.prefix.environment, "PYTHONPATH": paths}
    prefix = replace(installed.prefix, environment=environment)
    said = prefix.run(WORK / "python" / "python.exe", windows_path(script))
    found: dict[str, Any] = json.loads(said.splitlines()[-1])
    assert found["entry"] == NAME
    # The user, a colleague who has the entry, a visitor who has not, the administrator; state.
    assert found["seen"] == [
        [None, "old", None, None, False],
        ["new", "new", None, None, True],
        [None, "newer", None, None, False],
        [None, None, None, None, False],
    ]
