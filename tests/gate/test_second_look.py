"""The second look hides nothing: what it lets pass it names, and a real failure stays one."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.gate.second_look import MOST, NAMES, run

# Fails whenever the file is not there, and makes it.
FAILS_ONCE = """
from pathlib import Path
import pytest

def test_good():
    with Path("runs").open("a") as runs:
        runs.write("good\\n")

@pytest.mark.parametrize("name", ["a b", "c[d]"])
def test_moody(name):
    mark = Path(f"mark {name}")
    seen, _ = mark.exists(), mark.touch()
    assert seen
"""
ALWAYS_FAILS = "def test_bad():\n    assert not 'good'\n"
MANY_FAIL_ONCE = FAILS_ONCE.replace('["a b", "c[d]"]', f"range({MOST + 1})")


@pytest.fixture
def suite(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder in which pytest runs by itself."""
    (tmp_path / "pytest.ini").touch()
    monkeypatch.chdir(tmp_path)
    for variable in ("PYTEST_XDIST_WORKER", "PYTEST_ADDOPTS"):
        monkeypatch.delenv(variable, raising=False)
    return tmp_path


@pytest.mark.parametrize("distribution", [[], ["-n", "2"]])
def test_what_passes_by_itself_passes_and_is_named(
    suite: Path, distribution: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    (suite / "test_moods.py").write_text(FAILS_ONCE)
    assert run(distribution, suite / "build") == 0
    moody = ["test_moods.py::test_moody[a b]", "test_moods.py::test_moody[c[d]]"]
    assert (suite / "build" / NAMES).read_text().splitlines() == moody
    assert (
        "failed at first, and passed by themselves:\n  " + "\n  ".join(moody)
        in capfd.readouterr().out
    )
    # What passed is not run again.
    assert (suite / "runs").read_text() == "good\n"


def test_what_fails_twice_fails(suite: Path) -> None:
    (suite / "test_bad.py").write_text(ALWAYS_FAILS)
    (suite / "test_moods.py").write_text(FAILS_ONCE)
    assert run([], suite / "build") == 1
    assert not (suite / "build").exists()


def test_many_failures_get_no_second_look(suite: Path) -> None:
    (suite / "test_moods.py").write_text(MANY_FAIL_ONCE)
    assert run([], suite / "build") == 1
    assert (suite / "runs").read_text() == "good\n"
    assert not (suite / "build").exists()


@pytest.mark.parametrize(
    ("text", "code"), [("def test_good():\n    pass\n", 0), ("1 / 0\n", 2), ("", 5)]
)
def test_every_other_end_is_left_as_it_is(suite: Path, text: str, code: int) -> None:
    (suite / "test_it.py").write_text(text)
    assert run([], suite / "build") == code
    assert not (suite / "build").exists()
