"""Where the program is installed, for whom it starts, and what is left when it goes."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from installer.layout import PROGRAM, WORK, version
from installer.wine.prefix import windows_path
from tests.rigs.windows.agents import LOG, streaming_agent
from tests.rigs.windows.pc import NAME, UNINSTALL_KEY, WindowsPc
from tests.rigs.windows.registry import (
    BIN_FOLDER,
    DEFAULT_FOLDER,
    Registry,
    path_entries,
    start_menu,
)

pytestmark = pytest.mark.system

# Other folders than the default one, and a PC on which several people install.

PARENT = "Räume für Studien"
PLACE = rf"C:\{PARENT}\Gateway"


def into(folder: str) -> list[str]:
    # NSIS takes the rest of the line, without quotes; so none of its words may need them.
    return f"/D={folder}".split(" ")


def location(pc: WindowsPc) -> object:
    value = Registry.of(pc.prefix.folder).value(UNINSTALL_KEY, "InstallLocation")
    return value and value.data


def own_path_entries(pc: WindowsPc) -> list[str]:
    entries = path_entries(Registry.of(pc.prefix.folder))
    return [each for each in entries if "gateway" in each.lower()]


@pytest.mark.timeout(900)
def test_it_can_be_moved_and_is_never_there_twice(pc: WindowsPc, setup: Path) -> None:
    place = pc.drive_c / PARENT / "Gateway"
    assert pc.install(setup, *into(PLACE)).returncode == 0
    assert location(pc) == PLACE
    # Whoever can write there could have all users of the PC run what they like.
    assert own_path_entries(pc) == []
    assert not pc.program_folder.exists()
    said = pc.prefix.attempt(place / "bin" / f"{PROGRAM}.exe", "--version")
    assert (said.returncode, said.stdout.strip()) == (0, f"{PROGRAM} {version()}")

    # Whoever upgrades need not know where it is.
    assert pc.install(setup).returncode == 0
    assert location(pc) == PLACE
    assert own_path_entries(pc) == []
    assert not pc.program_folder.exists()

    # Another person wants it elsewhere, and be it the place that is the default.
    assert pc.install(setup, *into(DEFAULT_FOLDER)).returncode == 0
    assert location(pc) == DEFAULT_FOLDER
    assert own_path_entries(pc) == [BIN_FOLDER]
    assert pc.program.is_file()
    assert not place.exists()


@pytest.mark.timeout(900)
def test_a_way_out_of_program_files_is_no_way_onto_path(pc: WindowsPc, setup: Path) -> None:
    outside = r"C:\Program Files\..\Everybody\Gateway"
    assert pc.install(setup, *into(outside)).returncode == 0
    assert own_path_entries(pc) == []
    within = r"C:\Program Files\Lab\Gateway"
    assert pc.install(setup, *into(within)).returncode == 0
    assert own_path_entries(pc) == [rf"{within}\bin"]


@pytest.mark.timeout(900)
def test_a_file_that_cannot_be_written_is_no_success(pc: WindowsPc, setup: Path) -> None:
    in_the_way = pc.program_folder / "bin" / "_internal" / "python3.dll"
    in_the_way.mkdir(parents=True)
    assert pc.install(setup).returncode == 2
    assert location(pc) is None


# What is left when the program is uninstalled.
SETTINGS = b'[log]\nlevel = "info"\n'
SESSION_MANAGER = r"hklm\system\currentcontrolset\control\session manager"
# What Wine changes by itself, in every run.
OF_WINE = re.compile(
    # Its virtual graphics card and monitor are put in again at each start, with the date.
    r"hklm\\system\\currentcontrolset\\(control\\class|control\\deviceclasses|enum)\\"
    # As Windows does at the next start, it is to delete the uninstaller's copy of itself,
    # which NSIS puts on this list.
    rf"|{re.escape(SESSION_MANAGER)}\\pendingfilerenameoperations$"
    # The list of the host's fonts.
    r"|hkcu\\software\\wine\\fonts\\"
)
# The copy itself.
OF_NSIS = re.compile(r"users/[^/]+/Temp/~nsu\d*\.tmp/Un\.exe")


def foreign_changes(before: Registry, after: Registry) -> dict[str, object]:
    changes = after.changes_since(before)
    return {name: change for name, change in changes.items() if not OF_WINE.match(name)}


def settle(pc: WindowsPc) -> None:
    """Start it once, so that what Wine does at its first start is behind it."""
    pc.prefix.run("cmd", "/c", "ver")
    pc.prefix.settle()


@pytest.mark.timeout(900)
def test_only_the_user_s_own_files_are_left(pc: WindowsPc, setup: Path) -> None:
    settle(pc)
    files, registry = pc.files(), Registry.of(pc.prefix.folder)
    assert pc.install(setup, "/FIREWALL=1", "/AUTOSTART=1").returncode == 0
    assert foreign_changes(registry, Registry.of(pc.prefix.folder))
    own = {pc.user_folder / "settings.toml": SETTINGS, pc.user_folder / LOG: b"{}\n"}
    pc.user_folder.mkdir(parents=True)
    for path, content in own.items():
        path.write_bytes(content)
    pc.uninstall()
    left = {each for each in pc.files() - files if not OF_NSIS.fullmatch(each)}
    assert left == {str(path.relative_to(pc.drive_c)) for path in own}
    assert {path: path.read_bytes() for path in own} == own
    assert files - pc.files() == set()
    assert not pc.program_folder.exists()
    assert not start_menu(pc).exists()
    assert foreign_changes(registry, Registry.of(pc.prefix.folder)) == {}


@pytest.mark.timeout(900)
def test_settings_and_logs_go_when_asked_also_of_a_running_agent(
    installed: WindowsPc,
) -> None:
    foreign = installed.program_folder / "notes.txt"
    foreign.write_text("of the user")
    with streaming_agent(installed) as agent:
        (installed.user_folder / "settings.toml").write_bytes(SETTINGS)
        installed.uninstall("/REMOVE_SETTINGS=1", "/FORCE=1")
        agent.communicate(timeout=120)
        assert agent.returncode == 0
    assert not installed.user_folder.exists()
    assert list(installed.program_folder.iterdir()) == [foreign]
    registry = Registry.of(installed.prefix.folder)
    assert registry.key(UNINSTALL_KEY) is None
    assert not any(NAME in each for each in path_entries(registry))


# Whose registry gets what starts at logon, when somebody else has allowed the installation.
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


@pytest.mark.timeout(600)
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
