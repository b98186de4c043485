"""What the tests of the agent share: waiting, inlets, pseudo-terminals, processes."""

from __future__ import annotations

import contextlib
import os
import sys
import tty
import uuid
from collections.abc import Callable, Generator
from pathlib import Path
from typing import NamedTuple

import pytest

from biosensor_gateway import cli
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.world import World
from biosensor_gateway.system.logs import flush_logs
from tests.rigs.kept_logging import kept_logging
from tests.rigs.virtual_time import virtual_clock

__all__ = ["virtual_clock"]

DEADLINE_S = 30.0


@pytest.fixture
def unit() -> str:
    """A device that no other test has."""
    return uuid.uuid4().hex


class Pty:
    """A pseudo-terminal: our end is the device's, the other is a serial port."""

    def __init__(self) -> None:
        self.master, self._slave = os.openpty()
        tty.setraw(self.master)
        os.set_blocking(self.master, False)
        self.port = os.ttyname(self._slave)
        self._open = True

    def heard(self) -> bytes:
        with contextlib.suppress(BlockingIOError):
            return os.read(self.master, 65536)
        return b""

    def hang_up(self) -> None:
        if self._open:
            self._open = False
            os.close(self.master)
            os.close(self._slave)


@pytest.fixture
def pty() -> Generator[Pty]:
    terminal = Pty()
    yield terminal
    terminal.hang_up()


class Outcome(NamedTuple):
    code: int
    out: str
    err: str


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the command line looks for its settings; not there yet."""
    path = tmp_path / "config" / "settings.toml"
    monkeypatch.setenv("BIOSENSOR_GATEWAY_SETTINGS", str(path))
    return path


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("BIOSENSOR_GATEWAY_STATE", str(tmp_path / "state"))
    return tmp_path / "state"


@pytest.fixture
def logging_as_before() -> Generator[None]:
    """Undo what a command sets up: its handlers hold on to the captured console."""
    with kept_logging():
        yield


@pytest.fixture
def run(
    settings: Path,
    state: Path,
    logging_as_before: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> Callable[..., Outcome]:
    """Run a command in this process; one that fails without a sentence fails the test."""
    del settings, state, logging_as_before

    def command(*arguments: str) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["biosensor-gateway", *arguments])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        assert flush_logs(DEADLINE_S)
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err
        return Outcome(int(ended.value.code or 0), out, err)

    return command


@pytest.fixture
def radio(world: World) -> Generator[Radio]:
    """The air that this process's Bluetooth hears."""
    air = Radio(world)
    with virtual_bluetooth(air):
        yield air
