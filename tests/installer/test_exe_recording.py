"""The installed program records what its virtual sensors send, whatever ends the recording."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from biosensor_gateway.recording.labrecorder.recording_file import glance
from installer.wine.prefix import Prefix
from tests.rigs.windows.pc import PIPE_ENCODING, WindowsPc
from tests.rigs.windows.program import RunningProgram, lively, lsl_environment, wait_until

pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]

SETTINGS = b'[log]\nlevel = "info"\n# Sensoren von p01\r\n'
FEW = "zephyr,empatica_e4"
RECORDED_S, MOMENT_S, LOG_OFF_S = 20.0, 5.0, 60.0
DONE = 0
OF_A_BUSY_COMPUTER = {"clock", "clocks", "gap", "gaps", "lost", "losses", "late", "rate"}
"""What a recording may be amber for where Wine starves fourteen virtual sensors."""


class Pc(NamedTuple):
    """A PC with the program, and its Wine while programs run there."""

    windows: WindowsPc
    prefix: Prefix

    def gateway(self, *words: str) -> subprocess.CompletedProcess[str]:
        return self.prefix.attempt(self.windows.program, *words, encoding=PIPE_ENCODING)

    def told(self, *words: str) -> dict[str, Any]:
        ended = self.gateway(*words, "--json")
        # Warnings go to stderr, which is in the same pipe.
        begin = ended.stdout.find("{")
        assert begin >= 0, ended.stdout
        told: dict[str, Any] = json.JSONDecoder().raw_decode(ended.stdout[begin:])[0]
        return told

    def host_path(self, file: str) -> Path:
        return self.windows.drive_c / file.removeprefix("C:\\").replace("\\", "/")


@pytest.fixture(scope="module")
def pc(installed: WindowsPc) -> Pc:
    """A Windows that has windows, through which it tells of the session's end."""
    prefix = lively(installed, lsl_environment())
    key = r"HKCU\Software\Wine\Drivers"
    prefix.run("reg", "add", key, "/v", "Graphics", "/d", "null", "/f")
    installed.user_folder.mkdir(parents=True, exist_ok=True)
    (installed.user_folder / "settings.toml").write_bytes(SETTINGS)
    return Pc(installed, prefix)


@contextmanager
def recording(pc: Pc, sensors: str, task: str) -> Generator[tuple[RunningProgram, dict[str, Any]]]:
    """Stream and record; yields the agent, and what `record start` told."""
    folder = pc.windows.user_folder
    options = ("--no-ask", "--simulate", sensors)
    with RunningProgram(pc.prefix, pc.windows.program, folder, *options) as agent:
        ready = pc.gateway("wait-ready", "--timeout", "150")
        assert ready.returncode == DONE, ready.stdout
        where = ("--folder", r"C:\recordings", "--participant", "p01", "--task", task)
        yield agent, pc.told("record", "start", "--here", *where)


def _is_whole(file: Path) -> bool:
    return glance(file).is_closed


def test_all_virtual_sensors_are_recorded(pc: Pc) -> None:
    with recording(pc, "all", "all") as (agent, begun):
        assert [each for each in begun["warnings"] if "records instead" in each] == []
        time.sleep(RECORDED_S)
        ended = pc.told("record", "stop")
        assert pc.gateway("stop").returncode == DONE
        assert agent.exit_code() == DONE
    file = pc.host_path(begun["file"])
    verdict = ended["verdict"]
    print(verdict)
    assert verdict["colour"] in {"green", "amber"}
    found = {each["kind"] for each in verdict["findings"] if each["level"] != "note"}
    assert found <= OF_A_BUSY_COMPUTER, verdict["findings"]
    seen = glance(file)
    assert seen.is_closed
    assert len(seen.streams) == len(begun["streams"])
    checked = pc.gateway("xdf", "check", begun["file"])
    print(checked.stdout)
    assert checked.returncode == (0 if verdict["colour"] == "green" else 1), checked.stdout


def test_a_forced_upgrade_ends_the_recording_first_and_keeps_everything(
    pc: Pc, setup: Path
) -> None:
    with recording(pc, FEW, "upgraded") as (agent, begun):
        time.sleep(MOMENT_S)
        upgraded = pc.prefix.attempt(setup, "/S", "/FORCE=1")
        assert upgraded.returncode == DONE, upgraded.stdout
        assert agent.exit_code() == DONE
    file = pc.host_path(begun["file"])
    assert _is_whole(file)
    assert (pc.windows.user_folder / "settings.toml").read_bytes() == SETTINGS
    assert pc.gateway("xdf", "check", begun["file"]).returncode in {0, 1}
    # What is installed now goes on from there.
    with recording(pc, FEW, "upgraded") as (_, again):
        assert again["file"] != begun["file"]
        assert pc.gateway("record", "stop").returncode == DONE


def test_who_logs_off_leaves_a_whole_file(pc: Pc) -> None:
    with recording(pc, FEW, "logoff") as (agent, begun):
        time.sleep(MOMENT_S)
        try:
            pc.prefix.run("wineboot", "--end-session", timeout=LOG_OFF_S)
        except subprocess.TimeoutExpired:
            pc.prefix.run("wineboot", "--end-session", timeout=LOG_OFF_S)
        assert agent.exit_code() == DONE
    wait_until(lambda: _is_whole(pc.host_path(begun["file"])), "the file is closed")
