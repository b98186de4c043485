"""What is left when the program is uninstalled."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.rigs.windows.agents import LOG, streaming_agent
from tests.rigs.windows.desktop import path_entries, start_menu
from tests.rigs.windows.pc import NAME, UNINSTALL_KEY, WindowsPc
from tests.rigs.windows.registry import Registry

pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]

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
