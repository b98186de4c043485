"""Bad input to the installed program: a clear sentence each, and nothing else suffers."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pylsl
import pytest

from biosensor_common.naming import source_id
from biosensor_common.spec import DeviceIdentity
from installer.wine.prefix import windows_path
from tests.rigs.windows.pc import WindowsPc
from tests.rigs.windows.program import RunningProgram, lively, program_environment, wait_until

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]

USAGE = 2
SENSOR = "empatica_e4"
VIRTUAL = source_id(DeviceIdentity(SENSOR, "virtual"), "bvp")
SIMULATED = ("--simulate", SENSOR)


def only_sentence(ended: subprocess.CompletedProcess[str], code: int) -> str:
    (line,) = ended.stdout.splitlines()
    assert ended.returncode == code, line
    assert line.startswith("biosensor-gateway: ")
    return line


@pytest.mark.parametrize(
    ("settings", "place", "reason"),
    [
        ("[[device]\n", ", line 1, column 9: ", "expected ']]'"),
        ('\n[[device]]\nsensor = "ring"\n', ", line 3: ", "'ring'"),
        ('[[device]]\nsensor = "zephyr"\nunit = "1"\nport = 7\n', ", line 4: ", "device.port"),
        ("# \x00\n", ", line 1, column 3: ", "invalid character"),
    ],
    ids=["syntax", "unknown sensor", "wrong type", "binary"],
)
def test_broken_settings_are_refused_by_file_and_line(
    installed: WindowsPc, tmp_path: Path, settings: str, place: str, reason: str
) -> None:
    path = tmp_path / "Einstellungen für p01.toml"
    path.write_text(settings, encoding="utf-8")
    said = only_sentence(installed.gateway("run", "--settings", windows_path(path)), USAGE)
    assert windows_path(path) + place in said
    assert reason in said


@pytest.mark.parametrize("in_the_way", ["state", "state/biosensor-gateway.log"])
def test_it_streams_where_it_cannot_log(
    installed: WindowsPc, tmp_path: Path, in_the_way: str
) -> None:
    """Nothing can be written: below a file, or to a file in whose place there is a folder."""
    if in_the_way == "state":
        (tmp_path / in_the_way).touch()
    else:
        (tmp_path / in_the_way).mkdir(parents=True)
    folder = tmp_path / "state"
    with RunningProgram(
        lively(installed, program_environment(folder)), installed.program, folder, *SIMULATED
    ) as program:
        wait_until(lambda: VIRTUAL in streams(), "a stream")
        assert program.is_running
        said = program.said()
        program.press_ctrl_c()
        assert program.exit_code() == 0
    assert said.count(f"cannot write the log file in {windows_path(folder)}: ") == 1
    assert "Traceback" not in said


def test_a_second_one_is_refused_and_the_first_one_goes_on(
    installed: WindowsPc, tmp_path: Path
) -> None:
    prefix = lively(installed, program_environment(tmp_path))
    with RunningProgram(prefix, installed.program, tmp_path, *SIMULATED) as first:
        first.wait_for_state(SENSOR, "streaming")
        said = only_sentence(prefix.attempt(installed.program, "run", *SIMULATED), USAGE)
        assert f"already running with the state folder {windows_path(tmp_path)}" in said
        assert said.endswith("end it with: biosensor-gateway stop")
        before = first.report()["written"]
        wait_until(lambda: first.report()["written"] > before, "a newer status")
        (device,) = first.report()["devices"]
        assert (device["sensor"], device["state"]) == (SENSOR, "streaming")


def streams() -> set[str]:
    """Return the source_ids of all streams."""
    return {info.source_id() for info in pylsl.resolve_streams(1.0)}
