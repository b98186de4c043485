"""Users and folders of other names than English ones have."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path
from typing import NamedTuple

import pytest

from installer.layout import BIN, PROGRAM
from tests.rigs.windows.pc import WindowsPc
from tests.rigs.windows.program import RunningProgram, lively, lsl_environment

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]

SENSOR = "empatica_e4"


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
