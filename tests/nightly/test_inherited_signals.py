"""A run in the background ignores signals, but the programs that it starts do not."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tests.nightly.parts import ROOT

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals"),
]
PROGRAM = """
import os, signal, subprocess, sys
from tests.rigs.inherited_signals import let_programs_be_interrupted
if sys.argv[1:] == ["resets"]:
    let_programs_be_interrupted()
for number in (signal.SIGHUP, signal.SIGINT):
    os.kill(os.getpid(), number)
hung_up = subprocess.run([sys.executable, "-c", "import os; os.kill(os.getpid(), 1)"]).returncode
broken = subprocess.run(["sh", "-c", "kill -INT $$"]).returncode
print(hung_up, broken)
"""


def _endings(*arguments: str, under: str, **environment: str) -> str:
    command = ["sh", "-c", f"{under} exec {sys.executable} -c '{PROGRAM}' {' '.join(arguments)}"]
    ended = subprocess.run(
        command,
        cwd=ROOT,
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return ended.stdout.strip()


def test_programs_end_by_the_signals_that_the_run_ignores() -> None:
    ignoring = 'trap "" HUP INT;'
    assert _endings(under=ignoring) == "0 0"
    assert _endings("resets", under=ignoring) == "-1 -2"


def test_a_worker_of_such_a_run_goes_on_as_well() -> None:
    ended = _endings("resets", under='trap "" INT;', PYTEST_XDIST_WORKER="gw0")
    assert ended == "-1 -2"
