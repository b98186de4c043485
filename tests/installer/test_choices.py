"""The firewall rule and the start at logon: only when asked for, kept, taken back."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Generator
from dataclasses import replace
from pathlib import Path

import pytest

from installer.layout import PROGRAM
from tests.rigs.windows.agents import LOG, streaming_agent, wait_for_words
from tests.rigs.windows.pc import NAME, UNINSTALL_KEY, WindowsPc
from tests.rigs.windows.registry import (
    BIN_FOLDER,
    DEFAULT_FOLDER,
    OWN_KEY,
    RUN_KEY,
    Registry,
    Value,
    path_entries,
    search_path,
    start_menu,
)

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


SETTINGS = '[log]\nlevel = "info"\n# Über uns\r\n'
NOT_DONE, RUNS = 2, 3
IN_PLACE = f"_?={DEFAULT_FOLDER}".split(" ")
DEADLINE_S = 120.0


def traces(pc: WindowsPc) -> dict[Path, tuple[int, int, int]]:
    """Identity, size and time of change of all that the installer has written as files."""
    found = [*pc.program_folder.rglob("*"), *start_menu(pc).rglob("*")]
    stats = {each: each.stat() for each in found}
    return {each: (s.st_ino, s.st_size, s.st_mtime_ns) for each, s in stats.items()}


def own_registry(pc: WindowsPc) -> object:
    registry = Registry.of(pc.prefix.folder)
    return registry.key(UNINSTALL_KEY), search_path(registry)


def test_files_are_replaced_and_what_is_not_its_own_stays(
    installed: WindowsPc, setup: Path
) -> None:
    stale = installed.program_folder / "bin" / "_internal" / "of_an_earlier_version.pyd"
    foreign = installed.program_folder / "notes.txt"
    own = {
        installed.user_folder / "settings.toml": SETTINGS.encode(),
        installed.user_folder / LOG: b'{"event": "earlier"}\n',
        foreign: b"of the user\r\n",
    }
    # The tests before have left settings and a log there.
    installed.user_folder.mkdir(parents=True, exist_ok=True)
    for path, content in {stale: b"MZ", **own}.items():
        path.write_bytes(content)
    before = own_registry(installed)
    assert installed.install(setup).returncode == 0
    assert not stale.exists()
    assert {path: path.read_bytes() for path in own} == own
    assert own_registry(installed) == before
    entries = path_entries(Registry.of(installed.prefix.folder))
    assert entries.count(BIN_FOLDER) == 1
    foreign.unlink()


def test_a_running_session_is_not_closed_unasked(installed: WindowsPc, setup: Path) -> None:
    before = traces(installed), own_registry(installed)
    uninstall = [installed.program_folder / "uninstall.exe", "/S", *IN_PLACE]
    with streaming_agent(installed) as agent:
        for line in ([setup, "/S"], [setup, "/S", "/FORCE=0"], uninstall):
            assert installed.prefix.attempt(*line).returncode == RUNS
        assert agent.poll() is None
        assert installed.gateway("stop").returncode == 0
        agent.communicate(timeout=DEADLINE_S)
    installed.prefix.settle()
    assert (traces(installed), own_registry(installed)) == before


def test_a_running_agent_ends_cleanly_first(installed: WindowsPc, setup: Path) -> None:
    stale = installed.program_folder / "bin" / "_internal" / "of_an_earlier_version.pyd"
    stale.touch()
    with streaming_agent(installed) as agent:
        ended = installed.prefix.attempt(setup, "/S", "/FORCE=1")
        assert ended.returncode == 0, ended.stdout
        agent.communicate(timeout=DEADLINE_S)
        assert agent.returncode == 0
    installed.prefix.settle()
    lines = (installed.user_folder / LOG).read_text("utf-8").splitlines()
    events = [json.loads(line)["event"] for line in lines]
    ending = ["a command came", "the computer may go to sleep again"]
    # On a busy computer a packet that comes late may be told of between them.
    assert [each for each in events if each in ending][-2:] == ending
    assert events[-1] == ending[-1]
    assert not (installed.user_folder / "control.json").exists()
    assert not stale.exists()
    assert installed.program.is_file()


def test_nothing_changes_where_it_cannot_be_closed(installed: WindowsPc, setup: Path) -> None:
    before = traces(installed), own_registry(installed)
    # In place, because the copy that it starts otherwise tells nobody how it ended.
    uninstall = [installed.program_folder / "uninstall.exe", "/S", "/FORCE=1", *IN_PLACE]
    # Another user's agent; `stop` ends that of the same user alone.
    with streaming_agent(installed, r"C:\another") as agent:
        lines = ([setup, "/S", "/FORCE=1"], uninstall)
        attempts = [installed.prefix.start(*line) for line in lines]
        for attempt in attempts:
            attempt.communicate(timeout=DEADLINE_S)
        assert [attempt.returncode for attempt in attempts] == [NOT_DONE, NOT_DONE]
        assert agent.poll() is None
    installed.prefix.settle()
    assert (traces(installed), own_registry(installed)) == before
