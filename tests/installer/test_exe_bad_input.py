"""Bad input, odd names and planted programs: what the installed program makes of them."""

from __future__ import annotations

import subprocess
from collections.abc import Generator
from pathlib import Path
from typing import NamedTuple

import pylsl
import pytest

from biosensor_common.naming import source_id
from biosensor_common.spec import DeviceIdentity
from installer.layout import BIN, PROGRAM
from installer.wine.prefix import windows_path
from tests.rigs.windows.pc import WindowsPc
from tests.rigs.windows.program import (
    RunningProgram,
    lively,
    lsl_environment,
    program_environment,
    wait_until,
)
from tests.rigs.windows.registry import BIN_FOLDER

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]

# Bad input to the installed program: a clear sentence each, and nothing else suffers.

USAGE = 2
SENSOR = "empatica_e4"
VIRTUAL = source_id(DeviceIdentity(SENSOR, "virtual"), "bvp")
SIMULATED = ("--simulate", SENSOR)


def only_sentence(ended: subprocess.CompletedProcess[str], code: int) -> str:
    line, *more = ended.stdout.splitlines()
    assert (more, ended.returncode) == ([], code), ended.stdout
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


# Users and folders of other names than English ones have.
class Person(NamedTuple):
    """A user and a PC of theirs, with the program in a folder that they have chosen."""

    name: str
    pc: WindowsPc
    program: Path


# What a program prints into a pipe has 256 letters, of which the first name needs two more
# than English has; two letters of the second one are not among them.
@pytest.fixture(scope="module", params=["Jörg Müller", "Łukasz 李"])
def person(
    request: pytest.FixtureRequest, setup: Path, tmp_path_factory: pytest.TempPathFactory
) -> Generator[Person]:
    name: str = request.param
    folder = tmp_path_factory.mktemp("names")
    users = folder / "passwd"
    users.write_text(f"{name}:x:0:0:::/bin/sh\n", encoding="utf-8")
    # Wine's user has the name of the host's, for whom this is the list of all users.
    renamed = ("unshare", "--mount", "sh", "-c", 'mount --bind "$0" /etc/passwd && exec "$@"')
    with WindowsPc(folder / "disk", lsl_environment(), (*renamed, str(users))) as pc:
        ended = pc.install(setup, *rf"/D=C:\Studien von {name}\Gateway".split(" "))
        assert ended.returncode == 0, ended.stdout
        folder = pc.drive_c / f"Studien von {name}" / "Gateway"
        yield Person(name, pc, folder / BIN / f"{PROGRAM}.exe")


@pytest.fixture
def own_folder(person: Person) -> Path:
    return person.pc.drive_c / "users" / person.name / "AppData" / "Local" / PROGRAM


def test_settings_are_made_and_found(person: Person, own_folder: Path) -> None:
    settings = own_folder / "settings.toml"
    assert not settings.exists()
    for command in ("init", "check", "path"):
        ended = person.pc.prefix.attempt(person.program, "config", command)
        assert ended.returncode == 0, ended.stdout
        assert "Traceback" not in ended.stdout
    assert settings.is_file()


def test_it_streams_says_so_and_ends(person: Person, own_folder: Path) -> None:
    prefix = lively(person.pc)
    options = ("--simulate", SENSOR)
    with RunningProgram(prefix, person.program, own_folder, *options) as program:
        program.wait_for_state(SENSOR, "streaming")
        status = prefix.attempt(person.program, "status")
        assert (status.returncode, SENSOR in status.stdout) == (0, True), status.stdout
        stopped = prefix.attempt(person.program, "stop")
        assert stopped.returncode == 0, stopped.stdout
        assert program.exit_code() == 0
    assert program.log()


# Programs that somebody put into the folder in which a terminal is.
# All that the checks of Windows ever asked, as files that a search by name takes for them.
NAMES = ("sc", "netsh", "powercfg", "cmd", "powershell", "notepad")


def test_doctor_starts_none_of_them(installed: WindowsPc) -> None:
    folder = installed.drive_c / "study"
    folder.mkdir()
    for name in NAMES:
        (folder / f"{name}.bat").write_text("@echo planted> C:\\study\\ran.txt\r\n")
    checks = " ".join(f"--only {each}" for each in ("clock", "windows_firewall", "power"))
    command = f'"{BIN_FOLDER}\\{PROGRAM}.exe" doctor {checks}'
    (installed.drive_c / "go.bat").write_text(f"@cd /d C:\\study && {command}")
    ended = installed.prefix.attempt("cmd", "/c", r"C:\go.bat")
    assert "the Windows time service" in ended.stdout
    assert not (folder / "ran.txt").exists()
