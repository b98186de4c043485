"""The settings file, the state folder and the running agent."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from biosensor_common.doctor.check import Level
from biosensor_gateway.agent import status_file
from biosensor_gateway.doctor.context import Context, read_context
from tests.doctor.conftest import POLAR, above_ok, only

if TYPE_CHECKING:
    from tests.doctor.conftest import Examine

pytestmark = pytest.mark.nightly

DEADLINE_S = 30.0


def test_no_file_is_a_note_with_the_command(examine: Examine, tmp_path: Path) -> None:
    found = examine(read_context(tmp_path / "none.toml", tmp_path), "settings")
    missing = only(found, "no settings file")
    assert missing.level is Level.NOTE
    assert "biosensor-gateway config init" in missing.fix


def test_every_mistake_is_an_error_with_its_line(
    examine: Examine, configured: Callable[[str], Context]
) -> None:
    broken = configured('[lsl]\nsession = "x"\n[[device]]\nsensor = "polar_h11"\nunit = "1"\n')
    errors = above_ok(examine(broken, "settings"))
    assert [each.level for each in errors] == [Level.ERROR] * 2
    assert "settings.toml:2:" in errors[0].what or "line 2" in errors[0].what
    assert "polar_h10" in errors[1].what


def test_no_device_and_none_enabled_are_warnings(
    examine: Examine, configured: Callable[[str], Context]
) -> None:
    (without,) = above_ok(examine(configured(""), "settings"))
    assert (without.level, "no device is described" in without.what) == (Level.WARNING, True)
    (disabled,) = above_ok(examine(configured(POLAR + "enabled = false\n"), "settings"))
    assert (disabled.level, "no device is enabled" in disabled.what) == (Level.WARNING, True)


def test_good_settings_are_shown(examine: Examine, configured: Callable[[str], Context]) -> None:
    found = examine(configured(POLAR), "settings")
    assert not above_ok(found)
    assert "1 of 1 devices enabled: polar_h10 1" in found[0].what
    assert only(found, "no agent runs")


def test_a_driver_that_is_damaged_is_an_error(examine: Examine, context: Context) -> None:
    damaged = replace(context, problem=ImportError("no module named bleak"))
    found = only(examine(damaged, "settings"), "bleak")
    assert found.level is Level.ERROR


def test_a_state_folder_that_is_none(examine: Examine, context: Context, tmp_path: Path) -> None:
    file = tmp_path / "a file"
    file.touch()
    found = only(examine(replace(context, state_folder=file / "state"), "settings"), "state folder")
    assert found.level is Level.ERROR
    assert str(file) in found.fix


def test_looking_makes_nothing(examine: Examine, context: Context) -> None:
    assert not above_ok(examine(context, "settings"))[1:]
    assert not context.state_folder.exists()


def test_a_running_agent_is_shown(
    examine: Examine, configured: Callable[[str], Context], tmp_path: Path
) -> None:
    context = configured("")
    command = [sys.executable, "-m", "biosensor_gateway.cli", "run"]
    environment = os.environ | {
        "BIOSENSOR_GATEWAY_STATE": str(context.state_folder),
        "BIOSENSOR_GATEWAY_SETTINGS": str(context.settings_path),
    }
    with (tmp_path / "log").open("wb") as log:
        agent = subprocess.Popen(command, env=environment, stdout=log, stderr=log)
    try:
        deadline = time.monotonic() + DEADLINE_S
        while not (context.state_folder / status_file.STATUS_FILE).exists():
            assert time.monotonic() < deadline
            time.sleep(0.05)
        assert only(examine(context, "settings"), f"an agent runs (process {agent.pid})")
        agent.send_signal(signal.SIGSTOP)
        (context.state_folder / status_file.STATUS_FILE).write_text("{}")
        stuck = only(examine(context, "settings"), "does not report")
        assert stuck.level is Level.WARNING
    finally:
        agent.send_signal(signal.SIGCONT)
        agent.send_signal(signal.SIGINT)
        assert agent.wait(DEADLINE_S) is not None
