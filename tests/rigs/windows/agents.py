"""An agent that streams on a virtual PC, with one virtual E4."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from tests.rigs.windows.pc import WindowsPc

LOG = "biosensor-gateway.log"
_STREAMING = "kept from sleeping while a device streams"
_DEADLINE_S = 60.0
_STEP_S = 0.1


@contextmanager
def streaming_agent(pc: WindowsPc, state: str = "") -> Generator[subprocess.Popen[bytes]]:
    r"""Run an agent; it streams when the context begins and is gone when it ends.

    Parameters
    ----------
    pc
        Has the program.
    state
        Its state folder as Windows names it, on drive ``C:``; by default that of the PC's
        user, where ``stop`` looks for it.
    """
    log = (pc.drive_c / state.removeprefix("C:\\") if state else pc.user_folder) / LOG
    already = _size(log)
    environment = {**pc.prefix.environment, "BIOSENSOR_GATEWAY_STATE": state}
    prefix = replace(pc.prefix, environment=environment)
    process = prefix.start(pc.program, "run", "--simulate", "empatica_e4")
    try:
        wait_for_words(log, _STREAMING, already)
        yield process
    finally:
        process.kill()
        process.communicate()


def wait_for_words(log: Path, words: str, after: int = 0) -> None:
    """Wait until a log has certain words behind its first *after* bytes.

    Raises
    ------
    TimeoutError
        If they do not come.
    """
    deadline = time.monotonic() + _DEADLINE_S
    while _size(log) <= after or words not in log.read_bytes()[after:].decode():
        if time.monotonic() > deadline:
            raise TimeoutError(f"{log} does not say: {words}")
        time.sleep(_STEP_S)


def _size(log: Path) -> int:
    return log.stat().st_size if log.exists() else 0
