"""What the installer cannot close, before it closes anything."""

from __future__ import annotations

from pathlib import Path

import psutil
import pytest
from typer.testing import CliRunner

from biosensor_gateway.cli import installation
from biosensor_gateway.cli.installation import Closable, Program, sentence

EXE = r"C:\Program Files\Biosensor Gateway\bin\biosensor-gateway.exe"
OWN = Closable("PC\\ann", agent=10, page=True, recording=True)


def program(*words: str, user: str = "PC\\ann", family: frozenset[int] = frozenset({5})) -> Program:
    return Program(5, user, (EXE, *words), family)


@pytest.mark.parametrize(
    "program",
    [
        program("run", family=frozenset({5, 10})),
        # The one that starts it again, one that waits to take over, and its features.
        program("run", "--keep-alive", family=frozenset({5, 10, 11})),
        program("send-features", family=frozenset({10, 5})),
        program("page", "--window"),
        program(),
        program("play-recording"),
        program("keep-recording", r"C:\state"),
        program("record-streams", "a.xdf", "(true())"),
    ],
)
def test_what_the_commands_end_is_closed(program: Program) -> None:
    assert OWN.closes(program)


@pytest.mark.parametrize(
    "program",
    [
        # Of another state folder.
        program("run"),
        program("run", user="PC\\bob", family=frozenset({5, 10})),
        program("page", user=""),
        program("page", "--lsl"),
        program("features"),
        program("replay", "a.xdf"),
        program("status", "--watch"),
        Program(5, "PC\\ann", (), frozenset({5, 10})),
    ],
)
def test_all_else_is_not(program: Program) -> None:
    assert not OWN.closes(program)


def test_where_nothing_runs_by_the_locks_nothing_is_closed() -> None:
    none = Closable("PC\\ann", agent=None, page=False, recording=False)
    for words in (("run",), ("page",), ("keep-recording", "x")):
        assert not none.closes(program(*words))


def test_a_sentence_says_which_and_whose() -> None:
    assert sentence(program("features")) == r"biosensor-gateway features (process 5 of PC\ann)"
    unknown = Program(7, "", (), frozenset({7}))
    assert sentence(unknown) == "a program (process 7 of another user)"


class _Process:
    """A process whose name the system does not tell, as under Wine."""

    def __init__(self, number: int, *words: str, parent: _Process | None = None) -> None:
        self.pid, self._words, self._parent = number, list(words), parent
        self._children: list[_Process] = []
        if parent is not None:
            parent._children.append(self)

    def name(self) -> str:
        raise OSError(22, "Invalid parameter")

    def cmdline(self) -> list[str]:
        return self._words

    def username(self) -> str:
        return psutil.Process().username()

    def parents(self) -> list[_Process]:
        return [] if self._parent is None else [self._parent, *self._parent.parents()]

    def children(self, *, recursive: bool = False) -> list[_Process]:
        below = [each for child in self._children for each in child.children(recursive=True)]
        return [*self._children, *(below if recursive else [])]


def test_the_command_names_them_and_its_code_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BIOSENSOR_GATEWAY_STATE", str(tmp_path))
    running = [_Process(1, r"C:\windows\explorer.exe"), _Process(2, EXE, "features")]
    monkeypatch.setattr(psutil, "process_iter", lambda: iter(running))
    outcome = CliRunner().invoke(installation.app, ["holders"])
    assert outcome.exit_code == installation.EXIT_HELD
    assert outcome.output.startswith("biosensor-gateway features (process 2 of ")
    assert len(outcome.output.splitlines()) == 1
    running.pop()
    assert installation.programs_not_closable(tmp_path) == []
    assert CliRunner().invoke(installation.app, ["holders"]).exit_code == 0


def test_what_waits_to_take_over_for_an_agent_is_closed_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BIOSENSOR_GATEWAY_STATE", str(tmp_path))
    supervisor = _Process(11, EXE, "run", "--keep-alive")
    agent, standby = (_Process(each, EXE, "run", parent=supervisor) for each in (10, 12))
    other = _Process(13, EXE, "run")
    monkeypatch.setattr(psutil, "process_iter", lambda: iter([supervisor, agent, standby, other]))

    def number_of_agent(_state: Path) -> int:
        return agent.pid

    monkeypatch.setattr(installation, "_agent", number_of_agent)
    (held,) = installation.programs_not_closable(tmp_path)
    assert "process 13 of" in held
