"""Starts a Python that has BrainFlow, or says why it does not work, and reads its pipes."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from pylsl import local_clock

from biosensor_common import child
from biosensor_common.errors import ProtocolError, ProtocolReason, TransportError, TransportReason
from biosensor_gateway.devices.brainflow.declaration import Description
from biosensor_gateway.devices.brainflow.driver.settings import BrainFlowSettings
from biosensor_gateway.transports.link import Received
from biosensor_gateway.transports.threads import in_daemon_thread
from biosensor_gateway.transports.traffic import Traffic

_READ_BYTES = 65536
_END_LIMIT_S = 3.0

_OUTSIDE = "biosensor_gateway.devices.brainflow.outside"
_DESCRIBE_LIMIT_S = 20.0
_MISSING = "missing"


def start(settings: BrainFlowSettings, command: str) -> subprocess.Popen[bytes]:
    """Start the program of ``outside`` with pipes at both ends.

    Raises
    ------
    TransportError
        ``UNAVAILABLE``: there is no such Python.
    """
    program = [str(_python(settings)), "-I", str(files(_OUTSIDE) / "board.py"), command]
    try:
        return child.start(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    except OSError as error:
        message = f"{program[0]} cannot be started ({error.strerror or error}); is python right?"
        raise TransportError(TransportReason.UNAVAILABLE, message) from error


def _order(settings: BrainFlowSettings, presets: tuple[int, ...] = ()) -> bytes:
    """Return the line that tells the program what to read."""
    told = {
        "board": settings.board,
        "parameters": settings.parameters,
        "config": settings.config,
        "presets": presets,
    }
    return json.dumps(told).encode() + b"\n"


def described(settings: BrainFlowSettings) -> Mapping[int, Description]:
    """Return BrainFlow's description of a board by preset; asked once for each board.

    Raises
    ------
    TransportError, ProtocolError
        As for :func:`refusal`.
    """
    return _described(settings.python, settings.board, settings.master_board)


@lru_cache
def _described(python: str, board: str, master_board: str) -> Mapping[int, Description]:
    asked = BrainFlowSettings(
        sensor="brainflow", unit="-", board=board, python=python, master_board=master_board
    )
    process = start(asked, "describe")
    try:
        output, _ = process.communicate(_order(asked), _DESCRIBE_LIMIT_S)
        answer: dict[str, Any] = json.loads(output)
    except (subprocess.TimeoutExpired, ValueError) as error:
        process.kill()
        process.communicate()
        message = f"BrainFlow did not say what {board} has; does it work in {_python(asked)}?"
        raise TransportError(TransportReason.UNAVAILABLE, message) from error
    if "error" in answer:
        raise refusal(asked, answer)
    return {int(preset): description for preset, description in answer["presets"].items()}


def refusal(
    settings: BrainFlowSettings, answer: Mapping[str, Any]
) -> TransportError | ProtocolError:
    """Return what an ``error`` of the program means to a user.

    ``UNAVAILABLE`` without BrainFlow; ``REFUSED`` where BrainFlow does not get the board.
    """
    said = str(answer.get("said", ""))[:200]
    if answer["error"] == _MISSING:
        message = (
            f"BrainFlow is not in {_python(settings)} ({said}); install it with "
            '"pip install biosensor-gateway[brainflow]", or set python to one that has it'
        )
        return TransportError(TransportReason.UNAVAILABLE, message)
    message = (
        f"BrainFlow does not get {settings.board}: {said}; is it on, and are its settings right?"
    )
    return ProtocolError(ProtocolReason.REFUSED, message)


def _python(settings: BrainFlowSettings) -> Path:
    if settings.python:
        path = Path(settings.python)
        if not path.is_absolute():
            # By name, a program of the current folder would be started.
            message = f"python is {settings.python!r}, not a full path; write it from the root on"
            raise TransportError(TransportReason.UNAVAILABLE, message)
        return path
    if getattr(sys, "frozen", False):
        message = (
            "the installed program has no BrainFlow, whose licence forbids to pass it on; install "
            "Python and BrainFlow beside it, and set python to the full path of that Python"
        )
        raise TransportError(TransportReason.UNAVAILABLE, message)
    return Path(sys.executable)


class ProcessLink:
    """Starts the process, reads from it in a thread, and ends it."""

    def __init__(self, settings: BrainFlowSettings) -> None:
        self._settings = settings
        self._process: subprocess.Popen[bytes] | None = None
        self._traffic = Traffic("BrainFlow", "the process that reads the board has ended")

    async def open(self, presets: tuple[int, ...]) -> None:
        """Start it and tell it what to read.

        Raises
        ------
        TransportError
            ``UNAVAILABLE``: there is no such Python.
        """
        process = await in_daemon_thread(lambda: start(self._settings, "stream"))
        self._process = process
        self._traffic.start(lambda: self._read_forever(process), lambda: self._write(process))
        self._traffic.write(_order(self._settings, presets))

    async def read(self) -> Received:
        """Wait for the next bytes; raise ``LOST`` when the process has ended."""
        return await self._traffic.read()

    async def close(self) -> None:
        """Let the process release the board, and end it if it does not."""
        self._traffic.closing = True
        self._traffic.end_writing()
        if self._process is not None:
            await in_daemon_thread(self._end)

    def _end(self) -> None:
        process = self._process
        assert process is not None
        child.wait_or_kill(process, _END_LIMIT_S)
        self._traffic.join_reader(_END_LIMIT_S)

    def _read_forever(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None
        with process.stdout as pipe:
            while data := os.read(pipe.fileno(), _READ_BYTES):
                self._traffic.deliver(data, local_clock())
        self._traffic.lost()

    def _write(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdin is not None
        with contextlib.suppress(OSError), process.stdin as pipe:
            for data in self._traffic.outgoing():
                pipe.write(data)
                pipe.flush()
