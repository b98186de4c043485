"""Installing where the program is already; each test leaves it installed for the next."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.rigs.windows.agents import LOG, streaming_agent
from tests.rigs.windows.desktop import (
    BIN_FOLDER,
    DEFAULT_FOLDER,
    path_entries,
    search_path,
    start_menu,
)
from tests.rigs.windows.pc import UNINSTALL_KEY, WindowsPc
from tests.rigs.windows.registry import Registry

pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]

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
    installed.user_folder.mkdir(parents=True)
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
