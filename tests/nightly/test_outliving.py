"""What outlives its test is found, named and ended."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from tests.rigs.outliving import OF_A_FOLDER, end_all, outliving
from tests.rigs.polling import until

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(sys.platform == "win32", reason="processes have no tree that they leave"),
]
LEAVES = """
import subprocess, sys
nowhere = subprocess.DEVNULL
command = [sys.executable, "-c", sys.argv[1]]
print(subprocess.Popen(command, start_new_session=True, stdout=nowhere, stderr=nowhere).pid)
"""
WAITS = "import time; time.sleep(600)"
DEAF = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(600)"


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


def test_its_own_children_are_nobody_who_has_left(tmp_path: Path) -> None:
    environment = os.environ | {OF_A_FOLDER: str(tmp_path)}
    with subprocess.Popen([sys.executable, "-c", WAITS], env=environment) as child:
        assert not outliving(OF_A_FOLDER, tmp_path)
        child.kill()
