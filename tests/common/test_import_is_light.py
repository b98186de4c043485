import subprocess
import sys
from pathlib import Path

import pytest

import biosensor_common

pytestmark = pytest.mark.nightly

HEAVY = {"numpy", "pylsl", "rclpy"}
IMPORT_EVERYTHING = """
import sys
sys.path.insert(0, sys.argv[1])
from importlib import import_module
from pkgutil import walk_packages
import biosensor_common
for module in walk_packages(biosensor_common.__path__, "biosensor_common."):
    # Of a program of its own, which asks LSL; of pylsl's kind; bytes of messages from arrays.
    if module.name.partition(".")[2] not in (
        "doctor.survey", "lsl.inlet", "lsl.network", "lsl.outlet",
        "ros.cdr", "ros.messages", "ros.standard_messages",
    ):
        import_module(module.name)
print(*sys.modules)
"""


@pytest.mark.seam
def test_every_module_needs_the_standard_library_only() -> None:
    # Without site (-S) nothing that was installed can be imported at all.
    root = Path(biosensor_common.__path__[0]).parent
    result = subprocess.run(
        [sys.executable, "-I", "-S", "-c", IMPORT_EVERYTHING, str(root)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    loaded = set(result.stdout.split())
    assert {"biosensor_common.naming", "biosensor_common.table"} <= loaded
    assert not HEAVY & loaded


def test_no_module_takes_what_happens_to_be_installed() -> None:
    script = IMPORT_EVERYTHING.replace("sys.path.insert(0, sys.argv[1])", "")
    result = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert not HEAVY & set(result.stdout.split())
