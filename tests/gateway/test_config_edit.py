"""``config edit``: the settings file in the user's editor."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from biosensor_gateway.cli import config as settings_command

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

Run = Callable[..., "Outcome"]


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The only folder in which programs are found; nothing says which editor to use."""
    folder = tmp_path / "programs"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    for variable in ("VISUAL", "EDITOR"):
        monkeypatch.delenv(variable, raising=False)
    return folder


def install(folder: Path, name: str, code: int = 0) -> Path:
    """Install a program that writes down its arguments; return where it writes them."""
    program, notes = folder / name, folder / f"{name}.txt"
    program.write_text(
        f'#!/bin/sh\nfor each; do printf "%s\\n" "$each" >> "{notes}"; done\nexit {code}\n'
    )
    program.chmod(0o755)
    return notes


def lines(notes: Path) -> list[str]:
    return notes.read_text().splitlines()


@pytest.mark.nightly
def test_the_first_time_the_settings_are_written(run: Run, settings: Path, programs: Path) -> None:
    notes = install(programs, "xdg-open")
    assert run("config", "edit") == (0, f"wrote {settings}\n", "")
    assert lines(notes) == [str(settings)]
    assert run("config", "check").code == 0
    settings.write_text("# mine\n")
    assert run("config", "edit") == (0, "", "")
    assert settings.read_text() == "# mine\n"


@pytest.mark.nightly
def test_other_settings_can_be_named(
    run: Run, settings: Path, programs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(programs.parent)
    notes = install(programs, "xdg-open")
    assert run("config", "edit", "--settings", "other settings.toml").code == 0
    assert lines(notes) == [str(programs.parent / "other settings.toml")]
    assert not settings.exists()


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("variables", "arguments"),
    [
        ({"EDITOR": "mine"}, []),
        ({"VISUAL": "mine --wait 'a b'", "EDITOR": "other"}, ["--wait", "a b"]),
        ({"VISUAL": "", "EDITOR": "mine -n"}, ["-n"]),
    ],
)
def test_the_editor_of_the_environment_goes_first(
    run: Run,
    settings: Path,
    programs: Path,
    monkeypatch: pytest.MonkeyPatch,
    variables: dict[str, str],
    arguments: list[str],
) -> None:
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    notes, other = install(programs, "mine"), install(programs, "xdg-open")
    assert run("config", "edit").code == 0
    assert lines(notes) == [*arguments, str(settings)]
    assert not other.exists()


def test_without_an_editor_the_path_is_said(run: Run, settings: Path, programs: Path) -> None:
    del programs
    outcome = run("config", "edit")
    assert outcome.code == 2
    assert outcome.err.count("\n") == 1
    assert str(settings) in outcome.err
    assert settings.exists()


@pytest.mark.nightly
@pytest.mark.parametrize("editor_", ["missing", "failing", "'open"])
def test_an_editor_that_fails_is_named_with_the_path(
    run: Run, settings: Path, programs: Path, monkeypatch: pytest.MonkeyPatch, editor_: str
) -> None:
    install(programs, "failing", code=3)
    monkeypatch.setenv("EDITOR", editor_)
    outcome = run("config", "edit")
    assert outcome.code == 2
    assert outcome.err.count("\n") == 1
    assert editor_ in outcome.err
    assert str(settings) in outcome.err


def test_a_file_that_cannot_be_written_is_one_sentence(run: Run, programs: Path) -> None:
    notes = install(programs, "xdg-open")
    outcome = run("config", "edit", "--settings", str(notes.parent / "xdg-open" / "s.toml"))
    assert outcome.code == 2
    assert outcome.err.count("\n") == 1
    assert not notes.exists()


@pytest.mark.nightly
def test_macos_opens_a_text_editor(
    run: Run, settings: Path, programs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    notes = install(programs, "open")
    monkeypatch.setattr(settings_command.sys, "platform", "darwin")
    assert run("config", "edit").code == 0
    assert lines(notes) == ["-t", str(settings)]
