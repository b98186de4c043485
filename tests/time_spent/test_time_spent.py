"""Each run reports where its time went, and its longest and heavy files have their order."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.time_spent.plugin import ORDER, SYSTEM, Account, Folder

ROOT = Path(__file__).parents[2]
SLEEPY, WAITING, BUSY = 0.6, Folder("waiting"), Folder("busy")
WAITS = f"""
import time, pytest

@pytest.fixture(scope="module")
def slow():
    time.sleep({SLEEPY})

def test_it(slow):
    time.sleep({SLEEPY})

@pytest.mark.system
def test_elsewhere():
    pass
"""
WORKS = """
import subprocess, sys
WORK = "import time\\nwhile time.process_time() < 0.8: pass"

def test_child():
    subprocess.run([sys.executable, "-c", WORK], check=True)
"""


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    """Two folders of tests, of which one waits and the other works."""
    (tmp_path / "pytest.ini").write_text(
        "[pytest]\nmarkers = system\ntestpaths = tests\naddopts = --import-mode=importlib\n"
    )
    for folder, text in ((WAITING, WAITS), (BUSY, WORKS)):
        place = tmp_path / "tests" / folder.name / "deeper"
        place.mkdir(parents=True)
        (place / f"test_{folder.name}.py").write_text(text)
    return tmp_path


def _run(suite: Path, *options: str) -> tuple[int, str]:
    code = (
        f"import sys; sys.path.insert(0, {str(ROOT)!r}); import pytest; "
        "sys.exit(pytest.main(['-p', 'tests.time_spent.plugin', '-p', 'no:cacheprovider',"
        f" *{options!r}]))"
    )
    # What else is installed would be loaded, too, which takes seconds.
    environment = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    command = [sys.executable, "-c", code]
    ended = subprocess.run(
        command, cwd=suite, env=environment, capture_output=True, text=True, check=False
    )
    return ended.returncode, ended.stdout + ended.stderr


def _write_order(suite: Path, **lists: list[str]) -> None:
    (suite / ORDER).parent.mkdir(parents=True)
    (suite / ORDER).write_text("".join(f"{name} = {files}\n" for name, files in lists.items()))


def _columns(said: str, folder: Folder) -> list[str]:
    name = f"{folder} "
    (line,) = (
        line.removeprefix(name)
        for line in said.splitlines()
        if line.startswith(name) and "(" not in line.removeprefix(name)
    )
    return line.split()


@pytest.mark.nightly
@pytest.mark.parametrize("distribution", [(), ("-p", "xdist", "-n", "2")], ids=["one", "workers"])
def test_each_folder_has_its_seconds_and_how_busy_it_was(
    suite: Path, distribution: tuple[str, ...]
) -> None:
    code, said = _run(suite, *distribution)
    assert code == 0, said
    tests, seconds, busy = _columns(said, WAITING)
    assert tests == "1"
    assert float(seconds) >= 2 * SLEEPY
    assert float(busy) < float(_columns(said, BUSY)[2])
    assert _columns(said, Folder("waiting", SYSTEM))[0] == "1"
    assert "test_waiting.py::test_it" in said
    assert "test_waiting.py::test_elsewhere" not in said.partition("slowest")[2]


@pytest.mark.nightly
def test_the_longest_files_come_first(suite: Path) -> None:
    _, said = _run(suite, "-v")
    assert said.index("test_busy.py") < said.index("test_waiting.py")
    _write_order(suite, longest=["tests/waiting/deeper/test_waiting.py"])
    _, said = _run(suite, "-v")
    assert said.index("test_waiting.py") < said.index("test_busy.py")


@pytest.mark.nightly
def test_no_two_heavy_files_run_at_a_time(suite: Path) -> None:
    """They are all one worker's, where whole files are distributed."""
    files = [f"tests/busy/test_heavy_{letter}.py" for letter in "abc"]
    _write_order(suite, heavy=files)
    note = (
        "import os\nfrom pathlib import Path\n\ndef test_it():\n"
        "    Path(__file__).with_suffix('.worker').write_text(os.environ['PYTEST_XDIST_WORKER'])\n"
    )
    for file in files:
        (suite / file).write_text(note)
    code, said = _run(suite, "-p", "xdist", "-n", "3", "--dist", "loadfile")
    assert code == 0, said
    workers = {(suite / file).with_suffix(".worker").read_text() for file in files}
    assert len(workers) == 1


def test_parts_of_a_test_and_tests_of_a_folder_add_up() -> None:
    account = Account()
    for test, seconds in (("a", 1.0), ("b", 2.0), ("a", 4.0)):
        account.add(test, WAITING, seconds, seconds / 4)
    account.add("c", BUSY, 10.0, 20.0)
    folders = account.folders()
    assert [(folder, spent.seconds, spent.tests) for folder, spent in folders.items()] == [
        (BUSY, 10.0, 1),
        (WAITING, 7.0, 2),
    ]
    assert (folders[BUSY].busy, folders[WAITING].busy) == (2.0, 0.25)
    assert [test for test, _ in account.slowest(2)] == ["c", "a"]


def test_the_order_names_files_that_are_there() -> None:
    order = tomllib.loads((ROOT / ORDER).read_text(encoding="utf-8"))
    assert order.keys() == {"longest", "heavy"}
    assert [file for files in order.values() for file in files if not (ROOT / file).is_file()] == []
