"""The wheels for Linux hold liblsl, for computers for which pylsl brings none."""

from __future__ import annotations

import struct
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from installer.liblsl import PACKAGE, PROCESSORS, without_search_path
from tests.wheel.conftest import ROOT, Installed, build, uv

# As a linker writes them: kind and value. 29 is the search path, 1 a library that is needed.
ENTRIES = [(1, 7), (29, 1), (5, 0x40), (0, 0)]
MACHINES = {"x86_64": 62, "aarch64": 183}


def _library(entries: list[tuple[int, int]]) -> bytes:
    """A file of 64-bit Linux with nothing but the entries."""
    content = b"".join(struct.pack("<QQ", *each) for each in entries)
    head = b"\x7fELF\x02\x01".ljust(32, b"\0") + struct.pack("<Q", 64)
    head = head.ljust(54, b"\0") + struct.pack("<HH", 56, 1)
    program = struct.pack("<IIQQQQQQ", 2, 6, 120, 0, 0, len(content), len(content), 8)
    return head.ljust(64, b"\0") + program + content


def test_a_search_path_is_taken_out_and_all_else_stays() -> None:
    kept = [(1, 7), (5, 0x40), (0, 0), (0, 0)]
    assert without_search_path(_library(ENTRIES)) == _library(kept)
    assert without_search_path(_library(kept)) == _library(kept)


def test_what_is_no_library_is_refused() -> None:
    with pytest.raises(ValueError, match="64-bit Linux"):
        without_search_path(b"MZ")


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("liblsl")
    pip = ROOT / ".uv" / "bin" / "python"
    subprocess.run([pip, "-m", "installer.liblsl", folder], cwd=ROOT, check=True)
    return {
        each: build(ROOT, folder / f"{each}-wheel", "--wheel", liblsl=folder / each)
        for each in PROCESSORS
    }


@pytest.mark.nightly
def test_each_has_the_library_of_its_processor_and_the_licences(
    wheels: dict[str, Path], wheel: Path
) -> None:
    for processor, built in wheels.items():
        assert built.name.endswith(f"-py3-none-manylinux_2_26_{processor}.whl")
        with zipfile.ZipFile(built) as archive:
            library = archive.read(f"{PACKAGE}/liblsl.so")
            more = {each for each in archive.namelist() if not each.startswith(PACKAGE)}
            licences = [each for each in archive.namelist() if f"{PACKAGE}/LICENSE-" in each]
        assert struct.unpack_from("<H", library, 18)[0] == MACHINES[processor]
        assert len(licences) >= 5
        with zipfile.ZipFile(wheel) as archive:
            assert more == set(archive.namelist())


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("platform", "has_library"),
    [
        ("aarch64-manylinux_2_28", True),
        ("x86_64-manylinux_2_28", True),
        ("aarch64-apple-darwin", False),
        ("x86_64-pc-windows-msvc", False),
    ],
)
def test_an_installer_chooses_it_on_linux(
    wheels: dict[str, Path], wheel: Path, tmp_path: Path, platform: str, has_library: bool
) -> None:
    links = [f"--find-links={each.parent}" for each in (wheel, *wheels.values())]
    uv(
        *("pip", "install", "--no-deps", "--no-index", *links, "--python-platform", platform),
        *("--python-version", "3.12", "--target", tmp_path, "biosensor-gateway"),
    )
    assert (tmp_path / PACKAGE / "liblsl.so").is_file() is has_library


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform != "linux", reason="it is for Linux")
def test_where_pylsl_has_none_it_is_found_without_a_step_by_hand(
    wheels: dict[str, Path], wheel: Path, tmp_path: Path
) -> None:
    installed = Installed(tmp_path, wheel)
    libraries = [*tmp_path.glob("env/lib/python*/site-packages/pylsl/lib/*lsl*.so*")]
    assert libraries
    for each in libraries:
        each.unlink()
    for command in (("run", "--simulate", "polar_h10"), ("scan",), ("record", "start")):
        refused = installed.run(*command, codes=(1,))
        assert refused.startswith("biosensor-gateway: liblsl, the library")
        assert refused.count("\n") == 1
    installed.upgrade(wheels["x86_64"])
    assert f"{PACKAGE}/liblsl.so" in installed.run("doctor", codes=(0, 1))
    said = installed.run("try", "--no-open", "--seconds", "3")
    assert "3 sensors stream." in said
