"""Results are read from what pytest writes, kept, and joined into one page."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.nightly.parts import Part
from tests.nightly.report import is_good, report
from tests.nightly.result import LAST_LINES, Failure, Result
from tests.nightly.runner import Version

_CASE = '<testcase classname="{0}" name="{1}" file="tests/a.py">{2}</testcase>'
_CASES = [
    ("", "broken", "<error>no module</error>"),
    ("tests.a", "wrong[1]", "<failure>long\nE   assert 1 == 2</failure>"),
    ("tests.a", "twice", ""),
    ("tests.a", "twice", "<error>at the end</error>"),
    ("tests.a", "left_out", '<skipped message="no bus">tests/a.py: no bus</skipped>'),
    (
        "",
        "tests.a",
        "<skipped message=\"collection skipped\">('a.py', 3, 'Skipped: no bus')</skipped>",
    ),
]
JUNIT = f"<testsuites>{''.join(_CASE.format(*case) for case in _CASES)}</testsuites>"
VERSION = Version("0123456789abcdef", "Say more", (), "0123456789ab")
PARTS = [Part("one", "the first"), Part("two", "the second"), Part("three", "the third")]


def _passed(part: str, seconds: float = 0.0) -> Result:
    return Result(part, "2026-01-01T00:00:00+00:00", seconds=seconds, tests=5)


def test_numbers_failures_and_reasons_come_from_pytest(tmp_path: Path) -> None:
    (tmp_path / "junit.xml").write_text(JUNIT)
    result = Result("a", "")
    result.add_tests(tmp_path / "junit.xml")
    assert result.tests == 2
    assert result.skipped == {"no bus": 2}
    assert [(failure.test, failure.lines[-1]) for failure in result.failures] == [
        ("tests/a.py", "no module"),
        ("tests/a.py::wrong[1]", "E   assert 1 == 2"),
        ("tests/a.py::twice", "at the end"),
    ]
    assert result.state == "failed"


def test_a_result_is_read_as_it_was_written(tmp_path: Path) -> None:
    result = _passed("a", seconds=12.5)
    result.failures.append(Failure("tests/a.py::b", ["c"] * LAST_LINES))
    result.skipped["no bus"] = 3
    result.write(tmp_path / "deeper" / "a.json")
    assert Result.read(tmp_path / "deeper" / "a.json") == result


def test_the_page_says_what_failed_what_was_skipped_and_how_long_it_took() -> None:
    failed, skipped = (
        _passed("two", seconds=1900.0),
        Result("three", "2026-01-01", missing=["root"]),
    )
    failed.failures.append(Failure("tests/a.py::b", ["E   assert 0"]))
    failed.skipped["no bus"] = 1
    results = {"one": _passed("one", seconds=60.0), "two": failed, "three": skipped}
    page = report(VERSION, PARTS, results)
    assert "1 failed, 1 skipped, 1 passed. Commit 0123456789abcdef: Say more" in page
    assert "| one | passed | 5 | 0 | 0 | 1.0 | the first |" in page
    assert "| two | **failed** | 5 | 1 | 1 | 31.7 (over 30: divide it) | the second |" in page
    assert "### two: `tests/a.py::b`\n\n    E   assert 0\n" in page
    assert "- two, 1 test: no bus\n" in page
    assert "- three, the whole part: needs root" in page
    assert not is_good(PARTS, results)


def test_a_part_that_was_not_run_is_no_success() -> None:
    results = {part.name: _passed(part.name) for part in PARTS}
    assert is_good(PARTS, results)
    del results["two"]
    assert not is_good(PARTS, results)
    assert "1 not run, 2 passed." in report(VERSION, PARTS, results)


@pytest.mark.parametrize("changed", [(), (" M Makefile",)])
def test_a_changed_work_tree_is_said(changed: tuple[str, ...]) -> None:
    on = Version("0123456789abcdef", "Say more", changed, "key")
    assert ("not in this commit:**\n\n     M Makefile\n" in report(on, [], {})) is bool(changed)
