"""What a system cannot have is skipped with a reason; what it lacks by mistake is an error."""

from __future__ import annotations

import asyncio
import os
import re
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from tests.nightly.parts import ROOT
from tests.rigs.not_here import reasons
from tests.rigs.polling import until
from tests.rigs.processes import OF_A_FOLDER, end_all, outliving

PLUGIN = """
from tests.rigs.not_here import NotHere

def pytest_configure(config):
    config.pluginmanager.register(NotHere({"absent_here": "there is none"}))
"""
IMPORTS = ("--import-mode=importlib", "-o", "pythonpath=.")
FILES = {
    "conftest.py": PLUGIN,
    "whole/conftest.py": "import absent_here\nthing = 1\n",
    "whole/test_whole.py": "def test_it(): pass\n",
    "whole_again/conftest.py": "from whole.conftest import thing\n",
    "whole_again/test_whole_again.py": "def test_it(): pass\n",
    "test_file.py": "from absent_here.part import thing\ndef test_it(): pass\n",
    "test_later.py": "def test_it():\n    import absent_here\n",
    "test_well.py": "def test_it(): pass\n",
}


def run(folder: Path, files: dict[str, str]) -> str:
    for name, text in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    ended = subprocess.run(
        [sys.executable, "-m", "pytest", "-rs", "-p", "no:cacheprovider", *IMPORTS],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    return ended.stdout


@pytest.mark.nightly
def test_what_cannot_be_here_is_skipped_and_said(tmp_path: Path) -> None:
    said = run(tmp_path, FILES)
    assert "1 passed, 4 skipped" in said
    for name in ("whole", "whole_again", "test_file.py", "test_later.py"):
        assert re.search(
            rf"{name}(:\d+)?: NOT RUN ON THIS SYSTEM: no absent_here, there is none", said
        )


@pytest.mark.nightly
def test_what_is_missing_by_mistake_is_an_error(tmp_path: Path) -> None:
    said = run(tmp_path, {**FILES, "test_file.py": "import forgotten\n"})
    assert "1 error" in said
    assert "No module named 'forgotten'" in said


def test_nothing_is_left_out_where_everything_can_be_installed() -> None:
    if sys.platform == "linux" and os.uname().machine == "x86_64":
        assert reasons() == {}


# Programs that tests start can be interrupted, and do not outlive their test.


# A run in the background ignores signals, but the programs that it starts do not.


# What outlives its test is found, named and ended.
LEAVES = """
import subprocess, sys
nowhere = subprocess.DEVNULL
command = [sys.executable, "-c", sys.argv[1]]
print(subprocess.Popen(command, start_new_session=True, stdout=nowhere, stderr=nowhere).pid)
"""
WAITS = "import time; time.sleep(600)"
DEAF = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(600)"


@pytest.mark.nightly
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


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform == "win32", reason="processes have no tree that they leave")
def test_its_own_children_are_nobody_who_has_left(tmp_path: Path) -> None:
    environment = os.environ | {OF_A_FOLDER: str(tmp_path)}
    with subprocess.Popen([sys.executable, "-c", WAITS], env=environment) as child:
        assert not outliving(OF_A_FOLDER, tmp_path)
        child.kill()
