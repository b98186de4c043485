"""The checks inside ``ros2 doctor``, as far as its interface goes.

ros2doctor itself does not run here; see `tests/doctor/standin` for what stands in for it.
"""

from __future__ import annotations

import ast
import subprocess
import sys
import warnings
from collections.abc import Iterable, Iterator
from importlib import import_module
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

from biosensor_common.doctor.check import (
    AGENT,
    CHECKS,
    Category,
    Check,
    Context,
    Examine,
    Finding,
    checks_of,
    error,
    note,
    ok,
    warning,
)
from lsl_to_ros.doctor import ros2_doctor
from tests.doctor.made_checks import made

ROOT = Path(__file__).parents[2]
SETUP = ROOT / "ros_side" / "lsl_to_ros" / "setup.py"
STANDIN = Path(__file__).parent / "standin"


def entry_points() -> dict[str, list[EntryPoint]]:
    """The entry points as setup.py has them."""
    (call,) = (
        node
        for node in ast.walk(ast.parse(SETUP.read_text()))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "setup"
    )
    (given,) = (word.value for word in call.keywords if word.arg == "entry_points")
    groups: dict[str, list[str]] = ast.literal_eval(given)
    return {
        group: [
            EntryPoint(*(part.strip() for part in line.split("=")), group=group) for line in lines
        ]
        for group, lines in groups.items()
    }


@pytest.fixture
def api(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """What stands in for ros2doctor."""
    monkeypatch.setattr(sys, "path", [str(STANDIN), *sys.path])
    ros2_doctor.examined.cache_clear()
    yield import_module("ros2doctor.api")
    ros2_doctor.examined.cache_clear()
    for name in [each for each in sys.modules if each.startswith("ros2doctor")]:
        del sys.modules[name]


def raising(_: Context) -> Iterator[Finding]:
    yield ok("so far")
    raise ZeroDivisionError("a mistake")


def giving(*findings: Finding) -> Examine:
    def examine(_: Context) -> Iterable[Finding]:
        return findings

    return examine


def have(monkeypatch: pytest.MonkeyPatch, *checks: Check) -> None:
    monkeypatch.setattr(ros2_doctor, "CHECKS", checks)


def said(api: Any, **options: bool) -> tuple[Any, list[str]]:
    """What the checks come to, and what is shown meanwhile."""
    with warnings.catch_warnings(record=True) as shown:
        warnings.simplefilter("always")
        outcome = api.run_checks(entry_points()["ros2doctor.checks"], **options)
    return outcome, [str(each.message) for each in shown]


@pytest.mark.nightly
def test_errors_and_warnings_are_counted_and_shown_with_why_and_fix(
    api: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    bad = error("it is\x1b[2J broken", "it matters", "one\ntwo")
    have(monkeypatch, made("dds", giving(bad, ok("fine"), note("a note", "why", "fix"))))
    outcome, shown = said(api)
    assert outcome == ({"biosensors"}, 1, 1)
    assert shown == [
        "ERROR: dds: it is?[2J broken\n    why: it matters\n    fix: one\n         two"
    ]


@pytest.mark.nightly
def test_warnings_fail_only_where_they_are_included(
    api: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    have(monkeypatch, made("dds", giving(warning("it may break", "it matters", "fix it"))))
    outcome, shown = said(api)
    assert outcome == (set(), 0, 1)
    assert shown == ["dds: it may break\n    why: it matters\n    fix: fix it"]
    assert said(api, include_warnings=True)[0] == ({"biosensors"}, 1, 1)


@pytest.mark.nightly
def test_a_check_that_fails_stops_no_other(api: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    bad = error("broken", "it matters", "fix it")
    gone = "biosensor_common.doctor.no_such_module"
    have(
        monkeypatch,
        made("raises", raising),
        Check("no_such_module", Category.ROS, "", gone),
        made("last", giving(bad)),
    )
    outcome, shown = said(api)
    assert outcome == ({"biosensors"}, 1, 1)
    assert [each.splitlines()[0] for each in shown] == [
        "raises: the check failed: ZeroDivisionError: a mistake",
        f"no_such_module: the check failed: ModuleNotFoundError: No module named {gone!r}",
        "ERROR: last: broken",
    ]
    assert "python3 -m lsl_to_ros.doctor --only raises" in shown[0]


@pytest.mark.nightly
def test_the_report_has_everything_and_is_of_the_same_run(
    api: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs: list[int] = []

    def once(_: Context) -> Iterator[Finding]:
        runs.append(1)
        yield ok("fine")
        yield note("a note", "it matters", "do")

    have(monkeypatch, made("dds", once), made("bad", giving(error("broken", "why", "fix"))))
    (failed, _, _), _ = said(api)
    points = entry_points()["ros2doctor.report"]
    (report,) = api.generate_reports(points, categories=failed)
    assert report.name == ros2_doctor.TITLE
    assert report.items == [
        ("ok", "dds: fine"),
        ("note", "dds: a note\n    why: it matters\n    fix: do"),
        ("error", "bad: broken\n    why: why\n    fix: fix"),
    ]
    assert runs == [1]
    assert not api.generate_reports(points, categories={"network"})


@pytest.mark.nightly
def test_the_real_checks_run_in_it(api: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    have(monkeypatch, *(each for each in CHECKS if each.name in {"versions", "lsl_config"}))
    (report,) = api.generate_reports(entry_points()["ros2doctor.report"])
    texts = [text for _, text in report.items]
    assert any(text.startswith("versions: rclpy ") for text in texts)
    assert any(text.startswith("lsl_config: the node's: session ") for text in texts)


def test_the_node_s_table_is_the_common_one_and_its_own() -> None:
    assert set(ros2_doctor.CHECKS) == {each for each in CHECKS if each.program != AGENT}
    assert set(ros2_doctor.CHECKS) < set(checks_of(AGENT))


@pytest.mark.nightly
def test_it_needs_neither_ros2doctor_nor_the_agent() -> None:
    hidden = ("ros2doctor", "biosensor_gateway", "pydantic", "structlog", "typer")
    code = (
        f"import sys; sys.modules.update(dict.fromkeys({hidden!r}))\n"
        "from lsl_to_ros.doctor import ros2_doctor\n"
        "for check in ros2_doctor.CHECKS: check.load()\n"
        "print([each for each in ('rclpy', 'pylsl', 'psutil', 'numpy') if each in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stderr, done.stdout.strip()) == ("", "[]")
