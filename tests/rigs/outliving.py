"""Finds programs that tests have started and that nobody has ended.

Some are meant to outlive who starts them: an agent that a page has started, the supervisor of a
recording. A test that fails, or ends while such a program is only about to take its lock, leaves
it behind; it then runs beside all later tests, and for days.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import psutil

GRACE_S = 5.0
"""For one that is ending already."""
OF_A_RUN, OF_A_FOLDER = "LSLAPICFG", "BIOSENSOR_GATEWAY_STATE"
"""Variables that all programs inherit: of this run of tests, and of one test."""


def outliving(variable: str, value: str | Path) -> list[psutil.Process]:
    """Return programs that have this in their environment, and have left the tree of this one."""
    if sys.platform == "win32":
        return []
    mine = psutil.Process()
    known = {os.getpid(), *(each.pid for each in [*mine.parents(), *mine.children(recursive=True)])}
    return [
        each
        for each in psutil.process_iter()
        if each.pid not in known and _environment(each).get(variable) == str(value)
    ]


def end_all(found: Iterable[psutil.Process], grace_s: float = GRACE_S) -> list[str]:
    """End programs; say which of them did not end by themselves, and of which tests they are."""
    _, alive = psutil.wait_procs(list(found), timeout=grace_s)
    said = [f"{' '.join(_command(each))[-160:]} (of {_test(each)})" for each in alive]
    for each in alive:
        _tell(each, kill=False)
    _, deaf = psutil.wait_procs(alive, timeout=GRACE_S)
    for each in deaf:
        _tell(each, kill=True)
    return said


def _tell(process: psutil.Process, *, kill: bool) -> None:
    with suppress(psutil.NoSuchProcess):
        process.kill() if kill else process.terminate()


def _command(process: psutil.Process) -> list[str]:
    try:
        return process.cmdline()
    except psutil.Error:
        return ["?"]


def _test(process: psutil.Process) -> str:
    return _environment(process).get("PYTEST_CURRENT_TEST", "no test")


def _environment(process: psutil.Process) -> dict[str, str]:
    try:
        return process.environ()
    except (psutil.Error, OSError):
        return {}
