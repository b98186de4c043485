"""Each run says where its time went, and what took more than it may."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.time_spent.account import FAILS_ABOVE, SYSTEM, Account, Budget, Folder
from tests.time_spent.plugin import BUDGET

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
    tests, seconds, busy, allowed = _columns(said, WAITING)
    assert (tests, allowed) == ("1", "-")
    assert float(seconds) >= 2 * SLEEPY
    assert float(busy) < float(_columns(said, BUSY)[2])
    assert _columns(said, Folder("waiting", SYSTEM))[0] == "1"
    assert "test_waiting.py::test_it" in said
    assert "test_waiting.py::test_elsewhere" not in said.partition("slowest")[2]


@pytest.mark.nightly
def test_more_than_the_budget_is_said_and_much_more_fails_where_it_is_held(suite: Path) -> None:
    much_less = SLEEPY / FAILS_ABOVE / 2
    (suite / BUDGET).write_text(f"[test]\nwaiting = {much_less}\nbusy = 1000\n")
    code, said = _run(suite)
    assert code == 0, said
    assert "OVER BUDGET: waiting took " in said
    assert "OVER BUDGET: busy" not in said
    code, said = _run(suite, "--hold-budget")
    assert code == pytest.ExitCode.TESTS_FAILED, said


@pytest.mark.nightly
def test_no_two_heavy_files_run_at_a_time(suite: Path) -> None:
    """They are all one worker's, where whole files are distributed."""
    files = [f"tests/busy/test_heavy_{letter}.py" for letter in "abc"]
    (suite / BUDGET).write_text(f"heavy = {files}\n")
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
    assert Budget({BUSY: 5.0, WAITING: 7.0}).exceeded(folders) == {BUSY: 5.0}
    assert not Budget({BUSY: 5.0}).exceeded(folders, 2.0)


def test_the_budget_names_all_folders_and_files_that_are_there() -> None:
    tests, budget = ROOT / "tests", Budget.read(ROOT / BUDGET)
    having_tests = {path.relative_to(tests).parts[0] for path in tests.rglob("test_*.py")}
    assert {folder.name for folder in budget.folders} == having_tests
    assert [f for f in (*budget.longest, *budget.heavy) if not (ROOT / f).is_file()] == []
