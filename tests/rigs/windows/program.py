"""The installed program on a Windows PC while it runs, with its status and its log."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

from biosensor_gateway.agent.status_file import STALE_AFTER_S, STATUS_FILE
from biosensor_gateway.system.logs import LOG_FILE_NAME
from installer.wine.prefix import Prefix, WineError, windows_path
from tests.rigs.windows.pc import WindowsPc

DEADLINE_S = 60.0
_POLL_S = 0.05
# Right after another server of the same Windows has ended, one fails at times.
_ATTEMPTS = 3
# The end of its outputs may never come: services that it has started have them, too.
_LAST_WORDS_S = 5.0
_UTF8 = {"LC_ALL": "C.UTF-8"}
"""Wine passes on letters beyond ASCII in file names and arguments only then."""


def lively(pc: WindowsPc, environment: Mapping[str, str] | None = None) -> Prefix:
    """Return the PC's Wine, whose server now stays when its last program has ended.

    Server and services would otherwise be started by a program, and keep its pipes open.

    Parameters
    ----------
    environment
        Variables of all programs that are started by what is returned.
    """
    variables = {**pc.prefix.environment, **_UTF8, **(environment or {})}
    prefix = replace(pc.prefix, environment=variables)
    for _ in range(_ATTEMPTS):
        prefix.end()
        _run(prefix, "wineserver", "-p")
        # The first program starts Windows' services, which inherit its outputs and stay, too.
        if _run(prefix, "wine", "cmd", "/c", "exit") == 0:
            return prefix
    raise WineError(f"{prefix.folder}: no program starts")


def _run(prefix: Prefix, *words: str) -> int:
    """Run a command without pipes, because what it starts would keep them open."""
    ended = subprocess.run(
        [*prefix.before, *words],
        env=prefix.variables,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        check=False,
        timeout=DEADLINE_S,
    )
    return ended.returncode


def lsl_environment() -> dict[str, str]:
    """Return variables with which a program joins the LSL session of the tests."""
    return {"LSLAPICFG": windows_path(Path(os.environ["LSLAPICFG"]))}


def program_environment(folder: Path) -> dict[str, str]:
    """Return the same, and that a folder of the host gets its state."""
    return {**lsl_environment(), "BIOSENSOR_GATEWAY_STATE": windows_path(folder)}


def wait_until(holds: Callable[[], bool], expected: str) -> None:
    """Return once it holds; the test fails if it never does."""
    deadline = time.monotonic() + DEADLINE_S
    while not holds():
        assert time.monotonic() < deadline, f"never happened: {expected}"
        time.sleep(_POLL_S)


def read_status(folder: Path) -> dict[str, Any]:
    """Read what a program under Wine says of itself; empty if it has said nothing of late.

    Linux does not see the lock that the program holds there: to ask the product whether somebody
    holds it would remove the lock's file.
    """
    try:
        status: dict[str, Any] = json.loads((folder / STATUS_FILE).read_bytes())
    except (OSError, ValueError):
        return {}
    return status if time.time() - float(status["written"]) <= STALE_AFTER_S else {}


class RunningProgram:
    """``biosensor-gateway.exe run``; a context manager. Leaving it ends the program by force.

    Parameters
    ----------
    prefix
        Its Windows, with the environment that it is to have.
    program
        The installed program.
    folder
        Its state folder, which the environment names as well.
    arguments
        Behind ``run``.
    """

    def __init__(self, prefix: Prefix, program: Path, folder: Path, *arguments: str | Path) -> None:
        self._folder = folder
        self._said = bytearray()
        self._process = prefix.start(program, "run", *arguments)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.kill()
        self._process.wait()
        self._reader.join(_LAST_WORDS_S)

    @property
    def pid(self) -> int:
        """Of the process that has become the program: what leads to it begins no other."""
        return self._process.pid

    @property
    def is_running(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    def press_ctrl_c(self) -> None:
        """Have its console do what it does when Ctrl-C is pressed: Wine makes it of SIGINT."""
        self._process.send_signal(signal.SIGINT)

    def exit_code(self) -> int:
        """Wait until it has ended; its exit code."""
        code = self._process.wait(DEADLINE_S)
        self._reader.join(_LAST_WORDS_S)
        return code

    def said(self) -> str:
        """What it has printed so far."""
        return self._said.decode(errors="replace")

    def status(self) -> dict[str, Any]:
        """What it says of itself; empty if it has said nothing of late."""
        assert self.is_running, self.said()
        return read_status(self._folder)

    def device(self, sensor: str) -> dict[str, Any]:
        """What it says of one device; empty if it has said nothing of late."""
        devices: list[dict[str, Any]] = self.status().get("devices", [])
        return {each["sensor"]: each for each in devices}.get(sensor, {})

    def report(self) -> dict[str, Any]:
        """What it says of itself, once it says something."""
        deadline = time.monotonic() + DEADLINE_S
        while not (status := self.status()):
            assert time.monotonic() < deadline, f"it says nothing: {self.said()}"
            time.sleep(_POLL_S)
        return status

    def wait_for_state(self, sensor: str, state: str) -> None:
        """Wait until a device is in a state."""
        wait_until(lambda: self.device(sensor).get("state") == state, f"{sensor} is {state}")

    def log(self) -> list[dict[str, Any]]:
        """Everything that it has logged, as records."""
        path = self._folder / LOG_FILE_NAME
        # The last line may be half written; what is behind the last end of a line is no record.
        lines = path.read_bytes().split(b"\n")[:-1] if path.exists() else []
        return [json.loads(line) for line in lines]

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as pipe:
            while data := os.read(pipe.fileno(), 65536):
                self._said += data
