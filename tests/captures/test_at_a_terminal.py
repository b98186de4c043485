"""Somebody captures a device at a terminal, and replays the file there."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from biosensor_gateway.captures.file import ENDING, read

if sys.platform == "win32":
    pytest.skip("there are no pseudo-terminals", allow_module_level=True)

from tests.rigs.terminal import at_terminal

pytestmark = pytest.mark.nightly

PROGRAM = [sys.executable, "-m", "biosensor_gateway.cli", "capture"]


@pytest.mark.parametrize("sensor", ["polar_h10", "zephyr"])
def test_what_is_captured_in_real_time_is_replayed_at_once(sensor: str, tmp_path: Path) -> None:
    file = tmp_path / f"mine{ENDING}"
    order = [sensor, "--simulate", "--seconds", "8", "--output", str(file)]
    environment = {**os.environ, "BIOSENSOR_GATEWAY_STATE": str(tmp_path)}
    with at_terminal([*PROGRAM, *order], environment) as terminal:
        terminal.until_seen("throw it away:")
        terminal.type("yes\n")
        terminal.until_seen("or Enter:")
        terminal.type("\n")
        assert terminal.exit_code() == 0
    # A virtual device is not taken for a real one.
    assert read(file).header.source == "a virtual device"
    replayed = subprocess.run(
        [*PROGRAM, "replay", str(file), "--json"], capture_output=True, text=True, check=True
    )
    (report,) = json.loads(replayed.stdout).values()
    assert (report["connections"], report["problems"]) == (1, [])
    ecg = report["streams"]["ecg"]
    assert ecg["samples"] > 130
    assert (ecg["lost"], ecg["refused"], report["dropped_bytes"]) == (0, 0, 0)
