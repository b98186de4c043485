"""Programs that tests start can be interrupted, and do not outlive their test."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from tests.nightly.parts import ROOT
from tests.rigs.polling import until
from tests.rigs.processes import OF_A_FOLDER, end_all, outliving

pytestmark = pytest.mark.nightly

# A run in the background ignores signals, but the programs that it starts do not.

PROGRAM = """
import os, signal, subprocess, sys
from tests.rigs.processes import let_programs_be_interrupted
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


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_programs_end_by_the_signals_that_the_run_ignores() -> None:
    ignoring = 'trap "" HUP INT;'
    assert _endings(under=ignoring) == "0 0"
    assert _endings("resets", under=ignoring) == "-1 -2"


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_a_worker_of_such_a_run_goes_on_as_well() -> None:
    ended = _endings("resets", under='trap "" INT;', PYTEST_XDIST_WORKER="gw0")
    assert ended == "-1 -2"


# What outlives its test is found, named and ended.
LEAVES = """
import subprocess, sys
nowhere = subprocess.DEVNULL
command = [sys.executable, "-c", sys.argv[1]]
print(subprocess.Popen(command, start_new_session=True, stdout=nowhere, stderr=nowhere).pid)
"""
WAITS = "import time; time.sleep(600)"
DEAF = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(600)"


@pytest.mark.skipif(sys.platform == "win32", reason="processes have no tree that they leave")
@pytest.mark.parametrize("code", [WAITS, DEAF], ids=["waits", "deaf"])
async def test_what_was_left_behind_is_told_and_ended(code: str, tmp_path: Path) -> None:
    environment = os.environ | {OF_A_FOLDER: str(tmp_path)}
    command = [sys.executable, "-c", LEAVES, code]
    ask = partial(subprocess.run, env=environment, capture_output=True, check=True)
    done = await asyncio.to_thread(ask, command)
    found = outliving(OF_A_FOLDER, tmp_path)
    assert [each.pid for each in found] == [int(done.stdout)]
    (said,) = end_all(found, grace_s=0.0)
    assert "test_what_was_left_behind_is_told" in said
    await until(lambda: not outliving(OF_A_FOLDER, tmp_path))


@pytest.mark.skipif(sys.platform == "win32", reason="processes have no tree that they leave")
def test_its_own_children_are_nobody_who_has_left(tmp_path: Path) -> None:
    environment = os.environ | {OF_A_FOLDER: str(tmp_path)}
    with subprocess.Popen([sys.executable, "-c", WAITS], env=environment) as child:
        assert not outliving(OF_A_FOLDER, tmp_path)
        child.kill()
