"""The table of parts covers all tests, each once."""

from __future__ import annotations

import re
import tomllib

import pytest

from tests.nightly.parts import ROOT, read_parts
from tests.time_spent.plugin import ORDER

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
