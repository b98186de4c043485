"""The firewall rule and the start at logon: only when asked for, kept, taken back."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Generator
from dataclasses import replace
from pathlib import Path

import pytest

from installer.layout import PROGRAM
from tests.rigs.windows.agents import LOG, wait_for_words
from tests.rigs.windows.desktop import BIN_FOLDER, OWN_KEY, RUN_KEY, start_menu
from tests.rigs.windows.pc import NAME, WindowsPc
from tests.rigs.windows.registry import Registry, Value

pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]

EXE = rf"{BIN_FOLDER}\{PROGRAM}.exe"
ADDED = [
    *("advfirewall", "firewall", "add", "rule", f"name={NAME}", "dir=in", "action=allow"),
    *(f"program={EXE}", "remoteip=LocalSubnet", "profile=private,domain", "enable=yes"),
]
DELETED = ["advfirewall", "firewall", "delete", "rule", f"name={NAME}"]
# Without any device, it would ask.
DISABLED = '[[device]]\nsensor = "zephyr"\nunit = "1"\nport = "COM7"\nenabled = false\n'
AT_LOGON = "run --no-ask --keep-alive"
AUTOSTART = rf'"C:\windows\system32\cmd.exe" /c start "{NAME}" /min "{EXE}" {AT_LOGON}'

# Wine has a netsh that does nothing but tell its words.
TELLING = {"WINEDEBUG": "-all,fixme+netsh"}
TOLD = re.compile(r"fixme:netsh:\w+ stub: (.*)$", re.MULTILINE)
WORD = re.compile(r'L"((?:[^"\\]|\\.)*)"')


def netsh_calls(said: str) -> list[list[str]]:
    """Words of each call, without the program's name."""
    calls = (WORD.findall(words) for words in TOLD.findall(said))
    return [[word.replace("\\\\", "\\") for word in call[1:]] for call in calls]


def install(pc: WindowsPc, setup: Path, *options: str) -> list[list[str]]:
    """Install and return what netsh was asked for meanwhile."""
    prefix = replace(pc.prefix, environment={**pc.prefix.environment, **TELLING})
    ended = prefix.attempt(setup, "/S", *options)
    assert ended.returncode == 0, ended.stdout
    pc.prefix.settle()
    return netsh_calls(ended.stdout)


@pytest.fixture(scope="module")
def calls() -> list[list[str]]:
    """What netsh was asked for when the program was installed."""
    return []


@pytest.fixture(scope="module")
def chosen(setup: Path, installed: WindowsPc, calls: list[list[str]]) -> WindowsPc:
    """A PC on which the program was installed again, with all choices."""
    calls.extend(install(installed, setup, "/FIREWALL=1", "/AUTOSTART=1"))
    return installed


@pytest.fixture
def log(chosen: WindowsPc) -> Generator[Path]:
    """Where an agent of the PC's user, whose only device is disabled, writes its log."""
    chosen.user_folder.mkdir(parents=True, exist_ok=True)
    (chosen.user_folder / "settings.toml").write_text(DISABLED)
    log = chosen.user_folder / LOG
    yield log
    log.unlink(missing_ok=True)


def assert_it_runs_until_stopped(
    pc: WindowsPc, log: Path, starting: subprocess.Popen[bytes]
) -> None:
    try:
        wait_for_words(log, "no device is enabled in the settings")
        ended = pc.gateway("stop")
        assert (ended.returncode, ended.stdout.strip()) == (0, "the agent has ended")
    finally:
        starting.kill()
        starting.communicate()


def test_what_was_asked_for_is_done(chosen: WindowsPc, calls: list[list[str]]) -> None:
    registry = Registry.of(chosen.prefix.folder)
    assert calls == [ADDED]
    assert registry.value(OWN_KEY, "Firewall") == Value("REG_DWORD", 1)
    assert registry.value(RUN_KEY, NAME) == Value("REG_SZ", AUTOSTART)


def test_what_windows_does_at_logon_starts_the_agent(chosen: WindowsPc, log: Path) -> None:
    # From a file, because Wine would put backslashes before the quotes of an argument.
    (chosen.drive_c / "logon.bat").write_text(f"@{AUTOSTART}\r\n")
    starting = chosen.prefix.start("cmd", "/c", r"C:\logon.bat")
    assert_it_runs_until_stopped(chosen, log, starting)


def test_an_entry_of_the_start_menu_starts_the_agent(chosen: WindowsPc, log: Path) -> None:
    entry = start_menu(chosen) / "Run in a console.lnk"
    starting = chosen.prefix.start("start", "/wait", "/unix", entry)
    assert_it_runs_until_stopped(chosen, log, starting)


def test_an_upgrade_keeps_the_choices_until_they_are_taken_back(
    chosen: WindowsPc, setup: Path
) -> None:
    chosen.prefix.settle()
    assert install(chosen, setup) == [DELETED, ADDED]
    registry = Registry.of(chosen.prefix.folder)
    assert registry.value(OWN_KEY, "Firewall") == Value("REG_DWORD", 1)
    assert registry.value(RUN_KEY, NAME) == Value("REG_SZ", AUTOSTART)
    assert install(chosen, setup, "/FIREWALL=0", "/AUTOSTART=0") == [DELETED]
    registry = Registry.of(chosen.prefix.folder)
    assert registry.key(OWN_KEY) is None
    assert registry.value(RUN_KEY, NAME) is None
