"""Checks run side by side, and none of them can stop the others."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

from biosensor_common.doctor import report as runner
from biosensor_common.doctor.check import (
    AGENT,
    Category,
    Check,
    Finding,
    Level,
    checks_of,
    error,
    note,
    ok,
)
from biosensor_common.doctor.report import Report, run_checks
from biosensor_gateway.doctor.context import Context
from tests.doctor.made_checks import made

CHECKS = checks_of(AGENT)


def run(*checks: Check) -> Report:
    return run_checks(checks, Context(Path("settings.toml"), Path("state")))


def good(_: Context) -> Iterator[Finding]:
    yield ok("it is there")


def raising(_: Context) -> Iterator[Finding]:
    yield ok("so far")
    raise ZeroDivisionError("a mistake")


@pytest.mark.nightly
def test_findings_are_in_the_order_of_the_checks_whoever_is_first() -> None:
    first = threading.Event()

    def waits(_: Context) -> Iterator[Finding]:
        assert first.wait(30.0)
        yield ok("second")

    def signals(_: Context) -> Iterator[Finding]:
        yield ok("first")
        first.set()

    report = run(made("waits", waits), made("signals", signals))
    assert [(each.check, each.what) for each in report.findings] == [
        ("waits", "second"),
        ("signals", "first"),
    ]
    assert report.is_good


@pytest.mark.nightly
@pytest.mark.parametrize("problem", [ZeroDivisionError("no"), SystemExit(3), KeyboardInterrupt()])
def test_a_check_that_raises_is_a_finding(problem: BaseException) -> None:
    def fails(_: Context) -> Iterator[Finding]:
        yield ok("so far")
        raise problem

    report = run(made("fails", fails), made("good", good))
    so_far, failed, there = report.findings
    assert (so_far.what, there.what) == ("so far", "it is there")
    assert (failed.check, failed.level) == ("fails", Level.WARNING)
    assert type(problem).__name__ in failed.what
    assert "biosensor-gateway doctor --only fails" in failed.fix


@pytest.mark.nightly
def test_a_check_that_cannot_be_imported_is_a_finding() -> None:
    gone = Check("no_such_module", Category.PROGRAM, "", "biosensor_common.no_such_module")
    report = run(gone, made("good", good))
    failed, there = report.findings
    assert "ModuleNotFoundError" in failed.what
    assert there.level is Level.OK


@pytest.mark.nightly
def test_checks_that_hold_each_other_up_get_more_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "_ON_A_BUSY_COMPUTER", 1000)
    released = threading.Event()

    def slow(_: Context) -> Iterator[Finding]:
        released.wait()
        yield ok("it is there")

    threading.Timer(1.0, released.set).start()
    report = run(*(made(name, slow, limit_s=0.3) for name in ("one", "other")))
    assert [each.level for each in report.findings] == [Level.OK, Level.OK]


@pytest.mark.nightly
def test_a_check_that_hangs_is_a_finding_behind_what_it_found() -> None:
    release = threading.Event()

    def hangs(_: Context) -> Iterator[Finding]:
        yield error("found before", "it matters", "fix it")
        release.wait()

    begun = time.monotonic()
    report = run(made("hangs", hangs, limit_s=0.3), made("good", good))
    release.set()
    found, late, there = report.findings
    assert (found.what, found.level) == ("found before", Level.ERROR)
    assert (late.check, late.what) == ("hangs", "the check did not end within 0.3 s")
    assert late.fix
    assert there.what == "it is there"
    # The limit is the requirement; its double is for a busy machine.
    assert 0.3 <= report.seconds <= time.monotonic() - begun
    assert not report.is_good


@pytest.mark.nightly
def test_checks_that_hang_wait_at_the_same_time() -> None:
    release = threading.Event()

    def hangs(_: Context) -> Iterable[Finding]:
        release.wait()
        return []

    report = run(*(made(f"hangs-{number}", hangs, limit_s=1.0) for number in range(8)))
    release.set()
    assert len(report.findings) == 8
    # One after the other they would take 8 s.
    assert report.seconds < 5.0


_WAITS_IN_A_POOL = """
import sys, time
from concurrent.futures import ThreadPoolExecutor
from tests.doctor.made_checks import made
import {module} as module
from {program} import main

def hangs(_):
    with ThreadPoolExecutor(1) as pool:
        pool.submit(time.sleep, 60.0)
        print("begun", flush=True)
    return []

module.{checks}
sys.argv = ["program", *{arguments}]
sys.exit(main())
"""


@pytest.mark.parametrize(
    "program",
    [
        {
            "module": "biosensor_gateway.cli.doctor",
            "program": "biosensor_gateway.cli",
            "checks": "_CHECKS = [made('hangs', hangs)]",
            "arguments": ["doctor"],
        },
        {
            "module": "lsl_to_ros.doctor.__main__",
            "program": "lsl_to_ros.doctor.__main__",
            "checks": "checks_of = lambda _: [made('hangs', hangs)]",
            "arguments": [],
        },
    ],
    ids=["agent", "node"],
)
@pytest.mark.seam
@pytest.mark.skipif(sys.platform == "win32", reason="a signal of POSIX")
def test_ctrl_c_ends_it_while_a_check_waits_in_a_pool_of_threads(
    program: dict[str, object], tmp_path: Path
) -> None:
    script = _WAITS_IN_A_POOL.format(**program)
    command = [sys.executable, "-c", script]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[2],
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == "begun\n"
        process.send_signal(signal.SIGINT)
        begun = time.monotonic()
        try:
            assert process.wait(20.0) == 130
        finally:
            process.kill()
        assert time.monotonic() - begun < 5.0
        assert "Traceback" not in process.stderr.read()


def test_no_finding_above_ok_without_reason_and_remedy() -> None:
    assert ok("fine").fix == ""
    for why, fix in [("", "do"), ("because", "")]:
        with pytest.raises(ValueError, match="say why"):
            note("something", why, fix)


def test_every_check_of_the_table_is_there_and_ends_in_time() -> None:
    names = [check.name for check in CHECKS]
    assert len(set(names)) == len(names)
    for check in CHECKS:
        assert callable(check.load())
        assert check.title
        assert check.limit_s <= 15.0
