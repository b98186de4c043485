"""``biosensor-gateway doctor`` as a whole."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from biosensor_common.doctor import report
from biosensor_common.doctor.check import AGENT, checks_of
from tests.rigs.stopwatch import Stopwatch

CHECKS = checks_of(AGENT)

if TYPE_CHECKING:
    from tests.doctor.conftest import Outcome

Run = Callable[..., "Outcome"]
LIMIT_S = 20.0


@pytest.mark.seam
@pytest.mark.alone
def test_all_checks_are_done_and_say_what_to_do(run: Run) -> None:
    outcome = run("--json")
    content = outcome.json
    print(f"all checks: {content['seconds']} s")
    assert content["checks"] == [check.name for check in CHECKS]
    for each in content["findings"]:
        assert each["level"] == "ok" or (each["why"] and each["fix"])
    assert outcome.code == (0 if content["good"] else 1)


@pytest.mark.nightly
@pytest.mark.alone
def test_all_checks_end_within_the_limit(run: Run) -> None:
    watch = Stopwatch()
    content = run("--json").json
    stalled_s = watch.stalled_s()
    # The requirement itself.
    assert content["seconds"] - stalled_s < LIMIT_S
    failed = [each for each in content["findings"] if each["what"].startswith("the check")]
    assert not failed


@pytest.mark.nightly
def test_only_what_is_asked_for_is_looked_at(run: Run) -> None:
    content = run("--json", "--only", "host_name", "--only", "clock").json
    assert content["checks"] == ["host_name", "clock"]
    assert {each["check"] for each in content["findings"]} == {"host_name", "clock"}


def test_an_unknown_check_is_a_usage_error(run: Run) -> None:
    outcome = run("--only", "weather")
    assert outcome.code == 2
    assert "weather" in outcome.out


@pytest.mark.nightly
def test_an_error_is_exit_code_1(run: Run, tmp_path: Path) -> None:
    broken = tmp_path / "broken.toml"
    broken.write_text("[lsl]\nsession = 1\n")
    outcome = run("--only", "settings", "--settings", str(broken))
    assert outcome.code == 1
    assert "[ERROR]" in outcome.out


@pytest.mark.nightly
def test_the_text_is_ascii_marked(run: Run) -> None:
    out = run("--only", "versions").out
    assert out.startswith("Program\n  [ok]      versions: ")
    assert out.endswith(" s: no problem found\n")


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("modules", "unwanted"),
    [
        ("biosensor_gateway.agent.agent", r"\.doctor|^psutil$"),
        (
            "biosensor_common.doctor.report, biosensor_common.doctor.probe",
            "^(pylsl|bleak|psutil|numpy|rclpy)$",
        ),
    ],
    ids=["the agent does not load it", "the command's help loads nothing heavy"],
)
def test_what_is_not_loaded(modules: str, unwanted: str) -> None:
    code = f"import sys, {modules}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert [each for each in done.stdout.split() if re.search(unwanted, each)] == []


@pytest.mark.nightly
def test_the_output_suits_a_western_console(tmp_path: Path) -> None:
    path = tmp_path / "g\u0142adki\u2603.toml"
    path.write_text("[[device]]\nsensor = 1\n")
    code = "from tests.doctor.conftest import program; program()()"
    done = subprocess.run(
        [sys.executable, "-c", code, "doctor", "--only", "settings", "--settings", str(path)],
        env=os.environ | {"PYTHONIOENCODING": "cp1252", "BIOSENSOR_GATEWAY_STATE": str(tmp_path)},
        capture_output=True,
        check=False,
    )
    assert done.stderr == b""
    assert done.returncode == 1
    assert "device.sensor" in done.stdout.decode("cp1252")


def test_the_runner_knows_no_check() -> None:
    assert "CHECKS" not in vars(report)
