"""What the tests of the agent share: waiting, inlets, pseudo-terminals, processes."""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
import sys
import time
import tty
import uuid
from collections.abc import Awaitable, Callable, Generator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import NamedTuple

import pylsl
import pytest

from biosensor_gateway import cli
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.world import World
from biosensor_gateway.system.logs import flush_logs
from tests.open_outlets import outlets_of
from tests.rigs.kept_logging import kept_logging
from tests.rigs.virtual_time import virtual_clock

__all__ = ["virtual_clock"]

DEADLINE_S = 30.0
_POLL_S = 0.01


@pytest.fixture(scope="session")
def until() -> Callable[[Callable[[], bool]], None]:
    """Wait for a condition, for as long as it may take on a busy machine."""

    def wait(condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < deadline, "it did not happen"
            time.sleep(_POLL_S)

    return wait


@pytest.fixture(scope="session")
def eventually() -> Callable[[Callable[[], bool]], Awaitable[None]]:
    """The same on an event loop."""

    async def wait(condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < deadline, "it did not happen"
            await asyncio.sleep(_POLL_S)

    return wait


@pytest.fixture
def unit() -> str:
    """A device that no other test has."""
    return uuid.uuid4().hex


@pytest.fixture
def inlet() -> Callable[..., pylsl.StreamInlet]:
    """Find a stream by its source_id and begin to receive it.

    An inlet that does not recover gives nothing any more once its outlet has gone, not even
    what has arrived.
    """

    def opened(source_id: str, *, recover: bool = False) -> pylsl.StreamInlet:
        found = pylsl.resolve_byprop("source_id", source_id, timeout=DEADLINE_S)
        assert len(found) == 1
        reader = pylsl.StreamInlet(found[0], recover=recover)
        reader.open_stream(DEADLINE_S)
        # The sender has answered; only then it makes the queue for what is pushed.
        assert all(each.wait_for_consumers(DEADLINE_S) for each in outlets_of(source_id))
        return reader

    return opened


@pytest.fixture
def visible() -> Callable[[str], bool]:
    """Whether anybody offers a stream of that source_id."""

    def resolved(source_id: str) -> bool:
        return bool(pylsl.resolve_byprop("source_id", source_id, timeout=1.0))

    return resolved


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


@pytest.fixture(scope="session")
def cli_process() -> Callable[..., AbstractContextManager[subprocess.Popen[bytes]]]:
    """Run the command line as a process; state and stderr go into the given folder.

    ``before`` is Python that runs first, for what no real device does on demand.
    """

    @contextlib.contextmanager
    def started(
        folder: Path, *arguments: str, before: str = ""
    ) -> Generator[subprocess.Popen[bytes]]:
        environment = os.environ | {"BIOSENSOR_GATEWAY_STATE": str(folder)}
        code = f"{before}\nfrom biosensor_gateway.cli import main\nmain()"
        program = ["-c", code] if before else ["-m", "biosensor_gateway.cli"]
        command = [sys.executable, *program, *arguments]
        with (folder / "stderr.txt").open("wb") as stderr:
            process = subprocess.Popen(
                command, env=environment, stdout=subprocess.DEVNULL, stderr=stderr
            )
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()
            process.wait()

    return started


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
