"""Other folders than the default one, and a PC on which several people install."""

from __future__ import annotations

from pathlib import Path

import pytest

from installer.layout import PROGRAM, version
from tests.rigs.windows.desktop import BIN_FOLDER, DEFAULT_FOLDER, path_entries
from tests.rigs.windows.pc import UNINSTALL_KEY, WindowsPc
from tests.rigs.windows.registry import Registry

pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]

PARENT = "Räume für Studien"
PLACE = rf"C:\{PARENT}\Gateway"


def into(folder: str) -> list[str]:
    # NSIS takes the rest of the line, without quotes; so none of its words may need them.
    return f"/D={folder}".split(" ")


def location(pc: WindowsPc) -> object:
    value = Registry.of(pc.prefix.folder).value(UNINSTALL_KEY, "InstallLocation")
    return value and value.data


def own_path_entries(pc: WindowsPc) -> list[str]:
    entries = path_entries(Registry.of(pc.prefix.folder))
    return [each for each in entries if "gateway" in each.lower()]


def test_it_can_be_moved_and_is_never_there_twice(pc: WindowsPc, setup: Path) -> None:
    place = pc.drive_c / PARENT / "Gateway"
    assert pc.install(setup, *into(PLACE)).returncode == 0
    assert location(pc) == PLACE
    # Whoever can write there could have all users of the PC run what they like.
    assert own_path_entries(pc) == []
    assert not pc.program_folder.exists()
    said = pc.prefix.attempt(place / "bin" / f"{PROGRAM}.exe", "--version")
    assert (said.returncode, said.stdout.strip()) == (0, f"{PROGRAM} {version()}")

    # Whoever upgrades need not know where it is.
    assert pc.install(setup).returncode == 0
    assert location(pc) == PLACE
    assert own_path_entries(pc) == []
    assert not pc.program_folder.exists()

    # Another person wants it elsewhere, and be it the place that is the default.
    assert pc.install(setup, *into(DEFAULT_FOLDER)).returncode == 0
    assert location(pc) == DEFAULT_FOLDER
    assert own_path_entries(pc) == [BIN_FOLDER]
    assert pc.program.is_file()
    assert not place.exists()


def test_a_way_out_of_program_files_is_no_way_onto_path(pc: WindowsPc, setup: Path) -> None:
    outside = r"C:\Program Files\..\Everybody\Gateway"
    assert pc.install(setup, *into(outside)).returncode == 0
    assert own_path_entries(pc) == []
    within = r"C:\Program Files\Lab\Gateway"
    assert pc.install(setup, *into(within)).returncode == 0
    assert own_path_entries(pc) == [rf"{within}\bin"]


def test_a_file_that_cannot_be_written_is_no_success(pc: WindowsPc, setup: Path) -> None:
    in_the_way = pc.program_folder / "bin" / "_internal" / "python3.dll"
    in_the_way.mkdir(parents=True)
    assert pc.install(setup).returncode == 2
    assert location(pc) is None
