"""The table of parts covers all tests, each once."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.nightly.__main__ import main
from tests.nightly.parts import ROOT, read_parts
from tests.time_spent.plugin import ORDER

PARTS = read_parts()
by_signals = pytest.mark.skipif(sys.platform == "win32", reason="interrupts by signals")
FILES = sorted(path.relative_to(ROOT).as_posix() for path in ROOT.glob("tests/**/test_*.py"))


def parts_of(file: str, only: str) -> list[str]:
    """Return the names of the parts that run a kind of a file's tests."""
    return [
        part.name
        for part in PARTS
        if part.only == only
        and not part.environment
        and any(file == place or file.startswith(f"{place}/") for place in part.tests)
    ]


def having(mark: str) -> list[str]:
    """Return the files in which a test has a mark."""
    marked = re.compile(rf"^(?:pytestmark = |    )?.*@?pytest\.mark\.{mark}\b", re.MULTILINE)
    return [file for file in FILES if marked.search((ROOT / file).read_text(encoding="utf-8"))]


def wrongly_covered(files: list[str], only: str) -> dict[str, list[str]]:
    """Return the files that no part runs, or two."""
    parts = {file: parts_of(file, only) for file in files}
    return {file: names for file, names in parts.items() if len(names) != 1}


def test_each_file_belongs_to_exactly_one_part() -> None:
    assert wrongly_covered(FILES, "ordinary") == {}
    assert wrongly_covered(FILES, "seams") == {}


@pytest.mark.parametrize("mark", ["system", "alone"])
def test_each_file_with_a_special_mark_belongs_to_exactly_one_part_for_it(mark: str) -> None:
    files = having(mark)
    assert files
    assert wrongly_covered(files, mark) == {}


def test_parts_name_files_that_are_there() -> None:
    places = [place for part in PARTS for place in part.tests]
    assert [place for place in places if not (ROOT / place).exists()] == []


def test_each_part_has_a_name_of_its_own_and_something_to_do() -> None:
    names = [part.name for part in PARTS]
    assert len(set(names)) == len(names)
    assert [name for name in names if not re.fullmatch(r"[a-z0-9-]+", name)] == []
    assert [part.name for part in PARTS if not (part.tests or part.commands)] == []


def test_what_commands_name_exists() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for line in (line for part in PARTS for line in (*part.before, *part.commands)):
        match line.split():
            case ["make", *targets]:
                assert all(re.search(rf"^{each}:", makefile, re.MULTILINE) for each in targets)
            case ["python", "-m", module, *_]:
                path = ROOT / module.replace(".", "/")
                assert (path / "__main__.py").is_file() or path.with_suffix(".py").is_file()
            case _:
                pytest.fail(f"neither make nor a module: {line}")


def test_the_order_names_files_that_are_there() -> None:
    order = tomllib.loads((ROOT / ORDER).read_text(encoding="utf-8"))
    assert order.keys() == {"longest", "heavy"}
    assert [file for files in order.values() for file in files if not (ROOT / file).is_file()] == []


# Parts run once for a commit, go on after an interruption, and none stops another.


TABLE = """
[[part]]
name = "fails"
does = "says and fails"
commands = ["sh -c 'echo the reason; echo run >>runs; exit 3'"]

[[part]]
name = "passes"
does = "notes its seed"
commands = ["sh -c 'echo {seed} >>seeds'"]

[[part]]
name = "lacks"
does = "nothing here"
needs = ["program-that-nobody-has"]
commands = ["sh -c 'exit 1'"]

[[part]]
name = "waits"
does = "waits until it is interrupted, or told to end"
commands = ["sh -c '[ -e end ] || echo >waits; while ! [ -e end ]; do sleep 0.05; done'"]
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A repository with a table of parts, in which ``waits`` does not wait."""
    (tmp_path / "tests" / "nightly").mkdir(parents=True)
    (tmp_path / "tests" / "nightly" / "parts.toml").write_text(TABLE)
    (tmp_path / ".gitignore").write_text("build/\nruns\nseeds\nwaits\nend\n")
    (tmp_path / "end").touch()
    who = ("-c", "user.name=a", "-c", "user.email=a@example.org")
    for command in (["init", "-q"], ["add", "."], [*who, "commit", "-q", "-m", "First"]):
        subprocess.run(["git", *command], cwd=tmp_path, check=True)
    return tmp_path


def lines(file: Path) -> list[str]:
    return file.read_text().splitlines() if file.exists() else []


def page(project: Path) -> str:
    return (project / "build" / "nightly.md").read_text(encoding="utf-8")


@pytest.mark.nightly
@by_signals
def test_a_part_runs_once_for_a_commit_and_a_failed_one_stops_no_other(
    project: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([], project) == 1
    assert "1 failed, 1 skipped, 2 passed. " in page(project)
    assert "    the reason\n" in page(project)
    assert "needs program-that-nobody-has" in page(project)
    assert "lacks: SKIPPED, needs program-that-nobody-has" in capsys.readouterr().out
    assert main([], project) == 1
    assert (len(lines(project / "runs")), len(lines(project / "seeds"))) == (1, 1)
    assert main(["--again", "--part", "passes"], project) == 0
    assert (len(lines(project / "runs")), len(lines(project / "seeds"))) == (1, 2)


@pytest.mark.nightly
@by_signals
def test_tests_are_run_and_a_part_without_any_fails(project: Path) -> None:
    """By the project's own options, so in a folder of its own tests."""
    table = (
        '[[part]]\nname = "some"\ndoes = "tests"\ntests = ["tests/test_it.py"]\nonly = "seams"\n'
    )
    (project / "tests" / "nightly" / "parts.toml").write_text(table)
    (project / "tests" / "test_it.py").write_text(
        "import pytest\n\n@pytest.mark.seam\ndef test_it():\n    assert 1 == 2\n\n"
        '@pytest.mark.seam\n@pytest.mark.skip("no reason")\ndef test_skipped():\n    pass\n'
    )
    (project / "conftest.py").write_text('pytest_plugins = ["tests.tiers.plugin"]\n')
    (project / "pytest.ini").write_text("[pytest]\nmarkers = seam\njunit_family = xunit1\n")
    (project / "tests" / "tiers").symlink_to(ROOT / "tests" / "tiers")
    assert main([], project) == 1
    assert "### some: `tests/test_it.py::test_it`" in page(project)
    assert "- some, 1 test: no reason" in page(project)
    (project / "tests" / "test_it.py").write_text("def test_it():\n    pass\n")
    assert main([], project) == 1
    assert "    No test belongs to this part.\n" in page(project)
