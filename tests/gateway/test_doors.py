"""The doors of the program: what is imported before it is known what is wanted."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.core import TyperGroup

from biosensor_gateway.cli.app import COMMANDS, Deferred, app
from biosensor_gateway.settings.places import STATE_VARIABLE

# What takes a tenth of a second and more, each or with what it brings.
HEAVY = {
    "asyncio",
    "bleak",
    "keyring",
    "numpy",
    "psutil",
    "pydantic",
    "pylsl",
    "serial",
    "structlog",
    "tomlkit",
    "websockets",
}
OURS = {
    "biosensor_gateway",
    "biosensor_gateway.cli",
    "biosensor_gateway.cli.app",
    "biosensor_gateway.system",
    "biosensor_gateway.system.windows_console",
}
LOADED_AT_THE_END = """
import atexit, sys
atexit.register(lambda: sys.stderr.write(" ".join(sys.modules)))
from biosensor_gateway.cli import main
main()
"""

each_command = pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)


def loaded(*arguments: str, expected: int = 0) -> set[str]:
    """Modules that a run of the program has imported."""
    ended = subprocess.run(
        [sys.executable, "-c", LOADED_AT_THE_END, *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert ended.returncode == expected, ended.stderr
    return set(ended.stderr.split())


@pytest.mark.seam
@pytest.mark.parametrize(
    ("option", "more"), [("--version", {"rich"}), ("--help", {"pygments", "rich.markdown"})]
)
def test_the_first_look_imports_no_command(option: str, more: set[str]) -> None:
    modules = loaded(option)
    assert "typer" in modules
    assert not (HEAVY | more) & modules
    assert {name for name in modules if name.startswith("biosensor_gateway")} <= OURS


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["run", "stop", "pause", "resume", "status", "demo"])
def test_the_help_of_a_command_imports_no_agent(name: str) -> None:
    # Typer itself takes pydantic for each argument; run heeds signals from its first moment on.
    known = {"pydantic", "asyncio"} if name == "run" else {"pydantic"}
    assert not ((HEAVY | {"pygments", "rich.markdown"}) - known) & loaded(name, "--help")


@pytest.mark.nightly
@pytest.mark.parametrize("command", ["stop", "pause zephyr", "resume zephyr", "status"])
def test_who_asks_the_agent_imports_none(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(STATE_VARIABLE, str(tmp_path))
    modules = loaded(*command.split(), expected=1)
    assert "biosensor_gateway.settings.places" in modules
    assert not (HEAVY - {"pydantic"}) & modules
    assert "biosensor_gateway.settings.models" not in modules


@each_command
def test_the_list_says_what_the_command_says_of_itself(command: Deferred) -> None:
    text = inspect.cleandoc(command.load().help or "")
    assert command.first_lines() == text.partition("\n\n")[0] != ""


def test_the_program_has_the_commands_of_the_table() -> None:
    assert list(app().commands.values()) == list(COMMANDS)
    assert len({command.name for command in COMMANDS}) == len(COMMANDS)


@each_command
def test_help_is_wrapped_by_the_console_alone(command: Deferred) -> None:
    """Lines of the source are longer than a console of 80 columns, which would wrap them again."""
    waiting = [command.load()]
    while waiting:
        found = waiting.pop()
        assert "\n" not in (found.help or "").replace("\n\n", ""), found.name
        waiting += found.commands.values() if isinstance(found, TyperGroup) else ()


ROOT = Path(__file__).parents[2]


@pytest.mark.seam
def test_every_help_is_shown_and_every_use_says_one_sentence(tmp_path: Path) -> None:
    ended = subprocess.run(
        [sys.executable, "-m", "tests.gateway.without_liblsl"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert ended.returncode == 0, ended.stderr
    said: dict[str, dict[str, list[Any]]] = json.loads(ended.stdout)
    assert len(said["helps"]) > 40
    assert {command: each for command, each in said["helps"].items() if each != [0, ""]} == {}
    assert len(said["uses"]) > 4
    for command, (code, sentence) in said["uses"].items():
        assert code == 1, (command, sentence)
        assert sentence.startswith("biosensor-gateway: liblsl, the library"), command
        assert sentence.count("\n") == 1, command
        assert "pip install" in sentence or "PYLSL_LIB" in sentence, command
