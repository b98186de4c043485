"""``biosensor-gateway secrets``: what it asks, stores and forgets, and what it never shows."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import keyring
import pytest
from keyring.backends import fail

from tests.rigs import file_keyring
from tests.rigs.file_keyring import FileKeyring

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

Run = Callable[..., "Outcome"]

SENSOR = "emotiv_insight"
CLIENT_ID, CLIENT_SECRET = "planted-id-2b77", "planted-secret-94e1"
STORED = {
    "biosensor-gateway/emotiv_insight.client_id": CLIENT_ID,
    "biosensor-gateway/emotiv_insight.client_secret": CLIENT_SECRET,
}
QUESTIONS = ("The client id of the Cortex app: ", "The client secret of the Cortex app: ")
DEADLINE_S = 30.0


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Generator[Path]:
    """The keyring of this process and of those that it starts; empty."""
    path = tmp_path / "keyring.json"
    for variable in ("EMOTIV_CLIENT_ID", "EMOTIV_CLIENT_SECRET"):
        monkeypatch.delenv(variable, raising=False)
    for variable, text in file_keyring.environment(path).items():
        monkeypatch.setenv(variable, text)
    before = keyring.get_keyring()
    keyring.set_keyring(FileKeyring())
    yield path
    keyring.set_keyring(before)


@pytest.fixture
def no_keyring(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    del store
    monkeypatch.setenv("PYTHON_KEYRING_BACKEND", "keyring.backends.fail.Keyring")
    keyring.set_keyring(fail.Keyring())


class Terminal:
    """``secrets set`` at a terminal: what it shows, and what is typed."""

    def __init__(self, *arguments: str) -> None:
        self._ours, theirs = os.openpty()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "biosensor_gateway.cli", "secrets", *arguments],
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            start_new_session=True,
        )
        os.close(theirs)
        self.shown = ""

    def await_text(self, text: str) -> None:
        deadline = time.monotonic() + DEADLINE_S
        while text not in self.shown:
            assert time.monotonic() < deadline, f"{text!r} never came: {self.shown!r}"
            assert self._read(), f"it ended: {self.shown!r}"

    def type(self, line: str) -> None:
        os.write(self._ours, f"{line}\n".encode())

    def end(self) -> int:
        """Wait for its end; return the exit code."""
        while self._read():
            pass
        return self.process.wait(DEADLINE_S)

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self._ours)

    def _read(self) -> bool:
        if select.select([self._ours], [], [], DEADLINE_S)[0]:
            # Linux reports the end of the other side as an error.
            with suppress(OSError):
                heard = os.read(self._ours, 4096)
                self.shown += heard.decode()
                return bool(heard)
        return False


@pytest.fixture
def at_terminal() -> Generator[Callable[..., Terminal]]:
    started: list[Terminal] = []

    def start(*arguments: str) -> Terminal:
        started.append(Terminal(*arguments))
        return started[-1]

    yield start
    for each in started:
        each.close()


def put(path: Path, *names: str) -> None:
    for entry, text in STORED.items():
        if not names or entry.endswith(names):
            file_keyring.put(path, entry, text)


def one_sentence(outcome: Outcome, code: int) -> str:
    assert (outcome.code, outcome.out) == (code, "")
    assert outcome.err.startswith("biosensor-gateway: ")
    assert outcome.err.count("\n") == 1
    return outcome.err


@pytest.mark.seam
def test_set_asks_for_each_and_shows_none(
    store: Path, at_terminal: Callable[..., Terminal]
) -> None:
    terminal = at_terminal("set", SENSOR)
    for question, text in zip(QUESTIONS, (CLIENT_ID, CLIENT_SECRET), strict=True):
        terminal.await_text(question)
        terminal.type(text)
    assert terminal.end() == 0
    assert file_keyring.entries(store) == STORED
    assert "planted" not in terminal.shown
    assert "in the keyring" in terminal.shown


@pytest.mark.nightly
def test_set_asks_again_for_what_is_empty(
    store: Path, at_terminal: Callable[..., Terminal]
) -> None:
    terminal = at_terminal("set", SENSOR)
    terminal.await_text(QUESTIONS[0])
    terminal.shown = ""
    terminal.type("")
    terminal.await_text(QUESTIONS[0])
    terminal.type(CLIENT_ID)
    terminal.await_text(QUESTIONS[1])
    terminal.process.send_signal(signal.SIGINT)
    assert terminal.end() > 0
    assert "Traceback" not in terminal.shown
    assert "planted" not in terminal.shown
    assert list(file_keyring.entries(store).values()) == [CLIENT_ID]


@pytest.mark.nightly
@pytest.mark.usefixtures("no_keyring")
def test_set_without_a_keyring_is_one_sentence(at_terminal: Callable[..., Terminal]) -> None:
    terminal = at_terminal("set", SENSOR)
    terminal.await_text(QUESTIONS[0])
    terminal.type(CLIENT_ID)
    assert terminal.end() == 1
    *_, last = terminal.shown.split("\r\n")[:-1]
    assert last.startswith("biosensor-gateway: ")
    assert "no keyring; set EMOTIV_CLIENT_ID" in last
    assert "planted" not in terminal.shown
    assert "Traceback" not in terminal.shown


@pytest.mark.usefixtures("store")
def test_a_secret_is_never_an_argument(run: Run, store: Path) -> None:
    assert run("secrets", "set", SENSOR, CLIENT_SECRET).code == 2
    assert file_keyring.entries(store) == {}


@pytest.mark.parametrize("name", [SENSOR, "emotiv"])
def test_check_says_where_each_is_and_shows_none(
    run: Run, store: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    put(store)
    monkeypatch.setenv("EMOTIV_CLIENT_SECRET", CLIENT_SECRET)
    assert run("secrets", "check", name) == (
        0,
        (
            "The client id of the Cortex app: from the keyring\n"
            "The client secret of the Cortex app: from EMOTIV_CLIENT_SECRET\n"
        ),
        "",
    )


def test_check_names_every_one_that_is_missing(run: Run, store: Path) -> None:
    outcome = run("secrets", "check", SENSOR)
    assert (outcome.code, outcome.err) == (1, "")
    first, second = outcome.out.splitlines()
    assert "EMOTIV_CLIENT_ID" in first
    assert "EMOTIV_CLIENT_SECRET" in second
    assert f"secrets set {SENSOR}" in first
    put(store, "client_secret")
    outcome = run("secrets", "check", SENSOR)
    assert outcome.code == 1
    assert outcome.out.count("\n") == 2
    assert "client secret of the Cortex app: from the keyring" in outcome.out


def test_forget_removes_them_and_may_be_repeated(run: Run, store: Path) -> None:
    put(store)
    file_keyring.put(store, "another program/x", "kept")
    outcome = run("secrets", "forget", SENSOR)
    assert (outcome.code, outcome.out.count("removed from the keyring")) == (0, 2)
    assert list(file_keyring.entries(store).values()) == ["kept"]
    outcome = run("secrets", "forget", SENSOR)
    assert (outcome.code, outcome.out.count("was not in the keyring")) == (0, 2)


def test_forget_all_removes_those_of_every_sensor(run: Run, store: Path) -> None:
    put(store)
    file_keyring.put(store, "another program/x", "kept")
    outcome = run("secrets", "forget", "--all")
    assert (outcome.code, outcome.out.count("removed from the keyring")) == (0, 2)
    assert list(file_keyring.entries(store).values()) == ["kept"]


@pytest.mark.parametrize("arguments", [(), (SENSOR, "--all")])
def test_forget_wants_a_sensor_or_all(run: Run, store: Path, arguments: tuple[str, ...]) -> None:
    put(store)
    outcome = run("secrets", "forget", *arguments)
    assert (outcome.code, outcome.out) == (2, "")
    assert "name a sensor, or say --all" in outcome.err
    assert file_keyring.entries(store) == STORED


@pytest.mark.usefixtures("no_keyring")
def test_without_a_keyring_it_is_one_sentence(run: Run) -> None:
    assert "no keyring" in one_sentence(run("secrets", "forget", SENSOR), 1)
    checked = run("secrets", "check", SENSOR)
    assert (checked.code, checked.err) == (1, "")
    assert all("no keyring" in line for line in checked.out.splitlines())


@pytest.mark.usefixtures("no_keyring")
def test_the_environment_needs_no_keyring(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EMOTIV_CLIENT_ID", CLIENT_ID)
    monkeypatch.setenv("EMOTIV_CLIENT_SECRET", CLIENT_SECRET)
    outcome = run("secrets", "check", SENSOR)
    assert outcome.code == 0
    assert "planted" not in outcome.out


@pytest.mark.usefixtures("store")
@pytest.mark.parametrize("command", ["set", "forget", "check"])
def test_a_sensor_without_secrets_is_one_sentence(run: Run, command: str) -> None:
    assert "toaster" in one_sentence(run("secrets", command, "toaster"), 2)
    sentence = one_sentence(run("secrets", command, "polar_h10"), 2)
    assert "polar_h10 needs no secrets" in sentence
    assert SENSOR in sentence
