"""What the installed program consists of."""

from __future__ import annotations

import hashlib
import json
import re
import struct
import zipfile
from collections.abc import Iterator
from datetime import datetime
from fnmatch import fnmatch
from pathlib import Path
from typing import Any, cast

import pytest
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator

from biosensor_gateway.cli.app import COMMANDS
from installer.bundle import known
from installer.bundle.archive import read_archive
from installer.bundle.forbidden import refuse_forbidden
from installer.bundle.sbom import FILE_NAME, LICENCE_TEXT, MODULE
from installer.layout import BIN, PROGRAM, PUBLISHER, PYTHON, ROOT, portable_file, version

Entry = dict[str, Any]
MOST_BYTES = 130 * 2**20


@pytest.fixture(scope="module")
def bom(bundle: Path) -> Entry:
    return json.loads((bundle / FILE_NAME).read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def files(bundle: Path) -> list[str]:
    """What was installed, but the bill itself."""
    found = (path.relative_to(bundle) for path in bundle.rglob("*") if path.is_file())
    return sorted({path.as_posix() for path in found} - {FILE_NAME})


def entries(bom: Entry) -> Iterator[Entry]:
    """Go through all entries at every depth."""
    pending = [bom["metadata"]["component"], *bom["components"]]
    while pending:
        entry = pending.pop()
        yield entry
        pending += cast("list[Entry]", entry.get("components", []))


def properties(bom: Entry, name: str) -> Iterator[str]:
    for entry in entries(bom):
        for each in entry.get("properties", []):
            if each["name"] == name:
                yield each["value"]


@pytest.mark.system
def test_it_is_the_bill_of_this_product(bom: Entry) -> None:
    product = bom["metadata"]["component"]
    assert (product["name"], product["version"]) == (PROGRAM, version())


@pytest.mark.system
def test_it_says_when_it_was_made_and_who_supplies_what(bom: Entry) -> None:
    assert datetime.fromisoformat(bom["metadata"]["timestamp"]).year >= 2026
    assert bom["metadata"]["supplier"]["name"] == PUBLISHER
    components = [entry for entry in entries(bom) if entry["type"] != "file"]
    assert [each["name"] for each in components if not each["supplier"]["name"]] == []
    suppliers = {each["name"]: each["supplier"]["name"] for each in components}
    assert suppliers["cpython"] == "Python Software Foundation"
    assert "@" not in "".join(suppliers.values())


@pytest.mark.system
def test_what_is_tested_is_what_is_released(bom: Entry) -> None:
    """One Python and one lock: each package of the program is in the lock in that version."""
    lock = (ROOT / "requirements" / "freeze.txt").read_text(encoding="utf-8")
    locked = re.findall(r"^([\w.-]+)==([^ ;]+)", lock, re.MULTILINE)
    assert len(dict(locked)) == len(locked)
    held = {each["name"]: each["version"] for each in bom["components"]}
    assert held.pop("cpython") == PYTHON
    packages = {name: version for name, version in held.items() if name in dict(locked)}
    assert len(packages) > 40
    assert packages.items() <= dict(locked).items()


@pytest.mark.system
def test_the_archive_has_the_same_program_and_a_bill_of_its_own(bundle: Path, bom: Entry) -> None:
    with zipfile.ZipFile(portable_file()) as archive:
        top = f"{PROGRAM}-{version()}/"
        packed = {name.removeprefix(top): name for name in archive.namelist()}
        digests = {
            path: hashlib.sha256(archive.read(name)).hexdigest() for path, name in packed.items()
        }
        own = json.loads(archive.read(packed[FILE_NAME]))
    assert all(name.startswith(top) for name in packed.values())
    del digests[FILE_NAME]
    listed = {
        entry["name"]: entry["hashes"][0]["content"]
        for entry in entries(own)
        if entry["type"] == "file"
    }
    assert digests == listed
    assert f"{BIN}/{PROGRAM}.exe" in digests
    names = {each["name"] for each in bom["components"]}
    assert names - {each["name"] for each in own["components"]} == {"nsis"}
    assert not (bundle / portable_file().name).exists()


@pytest.mark.system
def test_it_follows_the_schema(bundle: Path) -> None:
    document = (bundle / FILE_NAME).read_text(encoding="utf-8")
    assert JsonStrictValidator(SchemaVersion.V1_6).validate_str(document) is None


@pytest.mark.system
def test_every_installed_file_is_in_it_as_it_was_built(
    bundle: Path, bom: Entry, files: list[str]
) -> None:
    listed = [
        (entry["name"], entry["hashes"][0]["content"])
        for entry in entries(bom)
        if entry["type"] == "file"
    ]
    installed = [(path, hashlib.sha256((bundle / path).read_bytes()).hexdigest()) for path in files]
    assert sorted(listed) == installed


@pytest.mark.system
def test_every_module_of_the_program_is_in_it(bundle: Path, bom: Entry) -> None:
    archive = read_archive(bundle / BIN / f"{PROGRAM}.exe")
    held = {*archive.scripts, *archive.modules}
    assert len(held) > 1000
    assert held <= set(properties(bom, MODULE))


@pytest.mark.system
def test_every_command_is_in_the_program(bundle: Path) -> None:
    # They are imported by name, which PyInstaller does not see.
    modules = {command.place.partition(":")[0] for command in COMMANDS}
    assert modules <= set(read_archive(bundle / BIN / f"{PROGRAM}.exe").modules)


@pytest.mark.system
def test_every_component_has_its_licence_and_the_text_of_it(bundle: Path, bom: Entry) -> None:
    components = [entry for entry in entries(bom) if entry["type"] != "file"]
    assert len(components) > 50
    for component in components:
        assert component["licenses"], component["name"]
        texts = list(
            properties({"metadata": {"component": component}, "components": []}, LICENCE_TEXT)
        )
        assert texts, component["name"]
        for text in texts:
            assert (bundle / text).stat().st_size > 0, text


@pytest.mark.system
@pytest.mark.parametrize(
    "name",
    [
        "cpython",
        "liblsl",
        "microsoft-vc-runtime",
        "nsis",
        "numpy",
        "OpenBLAS",
        "openssl",
        "pyinstaller",
    ],
)
def test_what_is_known_to_be_in_the_program_is_named(bom: Entry, name: str) -> None:
    assert name in {entry["name"] for entry in entries(bom)}


@pytest.mark.system
def test_nothing_is_in_it_that_must_not_be(bundle: Path, files: list[str]) -> None:
    refuse_forbidden(bundle, files, read_archive(bundle / BIN / f"{PROGRAM}.exe").modules)


@pytest.mark.system
def test_there_is_no_library_under_the_lgpl(bom: Entry, files: list[str]) -> None:
    assert not [path for path in files if "usb" in path.lower() or "dbus" in path.lower()]
    modules = set(properties(bom, MODULE))
    assert not {"usb", "usb1", "libusb_package", "dbus_fast"} & modules


@pytest.mark.system
def test_the_lsl_library_is_there(files: list[str]) -> None:
    assert [path for path in files if path.endswith("/lsl.dll")]


@pytest.mark.system
def test_it_is_no_larger_than_allowed(bundle: Path, files: list[str]) -> None:
    assert sum((bundle / path).stat().st_size for path in files) <= MOST_BYTES


@pytest.mark.system
def test_the_library_of_c_comes_along_for_each_binary_that_asks_for_it(bundle: Path) -> None:
    """A fresh Windows has none of it, nor has any other program to bring it."""
    programs = bundle / BIN
    everywhere = {each.name.lower() for each in (programs / "_internal").iterdir()}
    wanted: dict[str, set[str]] = {}
    for binary in programs.rglob("*"):
        if binary.suffix.lower() in {".dll", ".exe", ".pyd"}:
            beside = {each.name.lower() for each in binary.parent.iterdir()}
            runtime = {
                name
                for name in imported(binary)
                if any(fnmatch(name, pattern) for pattern in known.VC_RUNTIME_FILES)
            }
            wanted[binary.name] = runtime
            # A package has its own below a name that nobody else has.
            elsewhere = {each for each in runtime if re.search(r"-[0-9a-f]{32}", each)}
            assert runtime - elsewhere <= beside | everywhere, (binary, runtime)
    assert "msvcp140.dll" in wanted["lsl.dll"]
    assert "msvcp140.dll" in wanted["LabRecorderCLI.exe"]


_PE32_PLUS, _IMPORTS = 0x20B, 1


def imported(binary: Path) -> set[str]:
    """Return their names in small letters; those that are loaded on demand are not among them."""
    data = binary.read_bytes()
    (header,) = struct.unpack_from("<I", data, 0x3C)
    (count,) = struct.unpack_from("<H", data, header + 6)
    (optional_size,) = struct.unpack_from("<H", data, header + 20)
    optional = header + 24
    if struct.unpack_from("<H", data, optional) != (_PE32_PLUS,):
        # Programs of 32 bit that come along are for others to start.
        return set()
    sections = [
        struct.unpack_from("<IIII", data, optional + optional_size + 40 * each + 8)
        for each in range(count)
    ]

    def offset(address: int) -> int:
        for size, begin, raw_size, raw in sections:
            if begin <= address < begin + max(size, raw_size):
                return address - begin + raw
        raise ValueError(f"{binary}: no section has {address:#x}")

    (directory,) = struct.unpack_from("<I", data, optional + 112 + 8 * _IMPORTS)
    names: set[str] = set()
    at = offset(directory) if directory else 0
    while at and (name := struct.unpack_from("<5I", data, at)[3]):
        start = offset(name)
        names.add(data[start : data.index(b"\0", start)].decode("ascii").lower())
        at += 20
    return names
