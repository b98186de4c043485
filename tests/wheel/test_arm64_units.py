"""The unit tests on 64-bit ARM, emulated, of the rooms in which a processor could matter."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.wheel.arm64 import installed, needs

MISSING = needs()
UNIT = ("tests/common", "tests/xdf", "tests/recording_export", "tests/polar_h10")
# They read the tree's source, which is the same on all processors, or simulate hours, for minutes.
TOO_LONG = ("predicates", "system_programs", "clock_accuracy*", "device_clock*")


@pytest.mark.nightly
@pytest.mark.system
@pytest.mark.timeout(3900)
@pytest.mark.skipif(bool(MISSING), reason=f"NOT RUN: {MISSING}")
def test_unit_tests_pass_there(tmp_path: Path) -> None:
    """All of them would take an hour."""
    with installed(tmp_path) as arm:
        tests = arm.start_python(
            *("-m", "pytest", "--tier", "unit", "-q", "-n", "2", "-p", "no:cacheprovider", *UNIT),
            *(f"--ignore-glob=tests/common/test_{each}.py" for each in TOO_LONG),
            folder="/repository",
            PYTHONPATH="/tools:/site:/repository",
            PYLSL_LIB="/site/biosensor_liblsl/liblsl.so",
        )
        said = arm.ended(tests)
        print(said[-2000:])
        assert re.search(r"\d+ passed", said)
