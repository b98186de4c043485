"""The table of parts covers all tests, each once."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.nightly.parts import ROOT, TABLE, Part, read_parts

PARTS = read_parts()
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


def test_a_forgotten_folder_is_found() -> None:
    assert wrongly_covered(["tests/of_tomorrow/test_it.py"], "ordinary") == {
        "tests/of_tomorrow/test_it.py": []
    }


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
                assert (ROOT / module.replace(".", "/") / "__main__.py").is_file()
            case _:
                pytest.fail(f"neither make nor a module: {line}")


def test_a_wrong_kind_of_tests_is_refused(tmp_path: Path) -> None:
    table = tmp_path / TABLE.name
    table.write_text('[[part]]\nname = "a"\ndoes = "b"\nonly = "some"\n')
    with pytest.raises(ValueError, match='part a: only = "some" is none of'):
        read_parts(table)


def test_a_part_of_another_environment_is_run_by_its_python(tmp_path: Path) -> None:
    part = Part("a", "b", tests=("tests/x",), only="all", environment=".venv-b")
    command = part.test_command(tmp_path / "a.xml")
    assert command[:5] == [".venv-b/bin/python", "-m", "pytest", "-m", "not alone"]


def test_only_another_environment_runs_what_another_part_has() -> None:
    assert {part.only == "all" for part in PARTS if part.environment} == {True}
    assert {part.only == "all" for part in PARTS if not part.environment} == {False}


def test_a_need_that_is_not_met_is_missing() -> None:
    part = Part("a", "b", needs=("git-that-nobody-has", "python3"))
    assert part.missing()[0] == "git-that-nobody-has"


def test_tests_run_side_by_side_only_where_a_part_has_workers(tmp_path: Path) -> None:
    junit = tmp_path / "a.xml"
    alone = Part("a", "b", tests=("tests/x",), only="alone").test_command(junit)
    assert alone[1:] == [
        "-m",
        "pytest",
        "--tier",
        "nightly",
        "-m",
        "alone",
        f"--junit-xml={junit}",
        "tests/x",
    ]
    assert {"-n", "3"} < set(Part("a", "b", tests=("tests/x",), workers=3).test_command(junit))
