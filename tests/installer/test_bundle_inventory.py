"""Everything in a bundle belongs to something, in small bundles made by hand."""

from __future__ import annotations

import base64
import hashlib
import json
import marshal
import re
import struct
import zipfile
from collections.abc import Iterable, Iterator
from datetime import datetime
from fnmatch import fnmatch
from pathlib import Path
from typing import Any, cast

import pytest
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator

from biosensor_gateway.cli.app import COMMANDS
from installer.bundle import complete, known
from installer.bundle.archive import read_archive
from installer.bundle.cpython import CPython
from installer.bundle.distributions import read_distributions
from installer.bundle.errors import ArchiveError, ForbiddenFileError, UnknownFileError
from installer.bundle.forbidden import refuse_forbidden
from installer.bundle.inventory import take_inventory
from installer.bundle.model import Holding
from installer.bundle.sbom import FILE_NAME, LICENCE_TEXT, MODULE
from installer.layout import BIN, PUBLISHER, PYTHON, ROOT, portable_file, version
from installer.layout import PROGRAM as BUNDLED

# Everything in a bundle belongs to something, and nothing is in it that must not be.


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path)


def holdings(rig: Rig) -> dict[str, Holding]:
    rig.put(PROGRAM, frozen_program(rig.scripts, rig.modules))
    files = (path for path in rig.bundle.rglob("*") if path.is_file())
    return take_inventory(
        rig.bundle,
        [path.relative_to(rig.bundle).as_posix() for path in files],
        read_distributions((rig.packages, rig.product)),
        CPython(rig.python),
    )


def paths(holding: Holding) -> list[str]:
    return [file.path for file in holding.files]


def test_files_and_modules_go_to_those_that_brought_them(rig: Rig) -> None:
    found = holdings(rig)
    assert paths(found["biosensor-gateway"]) == [PROGRAM]
    assert found["biosensor-gateway"].modules == {"frozen", "biosensor_gateway"}
    assert paths(found["used-package"]) == ["_internal/used_c.pyd"]
    assert found["used-package"].modules == {"used"}
    assert paths(found["cpython"]) == ["_internal/base_library.zip", "_internal/python311.dll"]
    assert found["cpython"].modules == {"abc", "ast", "encodings"}


def test_a_library_that_was_moved_is_known_by_its_content(rig: Rig) -> None:
    rig.install("native", "2", {"native/lib/native.dll": b"MZ native"})
    rig.put("_internal/native.dll", b"MZ native")
    rig.put("_internal/native/lib/native.dll", b"MZ native")
    rig.put("_internal/_ssl.pyd", b"MZ ssl")
    found = holdings(rig)
    assert paths(found["native"]) == [
        "_internal/native.dll",
        "_internal/native/lib/native.dll",
    ]
    assert "_internal/_ssl.pyd" in paths(found["cpython"])


def test_empty_files_are_known_by_their_place_alone(rig: Rig) -> None:
    rig.install("typed", "2", {"typed/py.typed": b""})
    rig.put("_internal/typed/py.typed", b"")
    assert paths(holdings(rig)["typed"]) == ["_internal/typed/py.typed"]
    rig.put("_internal/elsewhere/py.typed", b"")
    with pytest.raises(UnknownFileError, match=r"elsewhere/py\.typed"):
        holdings(rig)


def test_microsofts_runtime_is_known_by_name_and_maker(rig: Rig) -> None:
    rig.put("_internal/MSVCP140.dll", MICROSOFTS)
    rig.put("_internal/numpy.libs/msvcp140-a4c2.dll", MICROSOFTS)
    assert len(holdings(rig)["microsoft-vc-runtime"].files) == 2
    rig.put("_internal/vcruntime140.dll", b"MZ by someone else")
    with pytest.raises(UnknownFileError, match=r"vcruntime140\.dll"):
        holdings(rig)


def test_every_unknown_file_and_module_is_named(rig: Rig) -> None:
    rig.put("_internal/stray.dll", b"MZ stray")
    rig.put("_internal/used_c.pyd", b"MZ changed since it was installed")
    rig.modules.append("stray.module")
    rig.scripts.append("pyi_rth_stray")
    rig.put_library("abc.pyc", "hidden.txt")
    with pytest.raises(UnknownFileError) as caught:
        holdings(rig)
    for name in (
        "_internal/stray.dll",
        "_internal/used_c.pyd",
        "biosensor-gateway.exe!stray.module",
        "biosensor-gateway.exe!pyi_rth_stray",
        "_internal/base_library.zip!hidden.txt",
    ):
        assert name in str(caught.value)


def test_run_time_hooks_are_pyinstallers(rig: Rig) -> None:
    hooks = "PyInstaller/hooks/rthooks"
    loader = {"PyInstaller/loader/pyimod01_archive.py": b"", f"{hooks}/pyi_rth_a.py": b""}
    rig.install("pyinstaller", "6", loader)
    rig.install("pyinstaller-hooks-contrib", "1", {"_pyinstaller_hooks_contrib/rthooks/b.py": b""})
    rig.scripts += ["pyi_rth_a", "b"]
    rig.modules.append("pyimod01_archive")
    found = holdings(rig)
    assert found["pyinstaller"].modules == {"pyi_rth_a", "pyimod01_archive"}
    assert found["pyinstaller-hooks-contrib"].modules == {"b"}


@pytest.mark.parametrize(
    "path",
    [
        "_internal/ucrtbase.dll",
        "_internal/UCRTBASE.DLL",
        "_internal/api-ms-win-crt-runtime-l1-1-0.dll",
        "_internal/bcryptprimitives.dll",
        "_internal/lsl_to_ros/node.py",
        "_internal/lsl_to_ros-0.1.0.dist-info/METADATA",
        "_internal/pytest-9.0.0.dist-info/METADATA",
        "_internal/numpy/tests/data.csv",
    ],
)
def test_forbidden_files_are_refused(rig: Rig, path: str) -> None:
    rig.put(path, b"MZ")
    with pytest.raises(ForbiddenFileError, match=path.replace(".", r"\.")):
        holdings(rig)


@pytest.mark.parametrize("module", ["lsl_to_ros.node", "_pytest.main", "numpy.tests.test_core"])
def test_forbidden_modules_are_refused(rig: Rig, module: str) -> None:
    rig.modules.append(module)
    with pytest.raises(ForbiddenFileError, match=f"module {module}"):
        holdings(rig)


@pytest.mark.parametrize("mark", [b"Wine builtin DLL\0", b"Wine placeholder DLL\0"])
def test_libraries_of_wine_are_refused(rig: Rig, mark: bytes) -> None:
    library = b"MZ".ljust(0x40, b"\0") + mark
    rig.install("bringer", "1", {"native.dll": library})
    rig.put("_internal/native.dll", library)
    with pytest.raises(ForbiddenFileError, match=r"native\.dll \(a library of Wine\)"):
        holdings(rig)


def test_a_folder_without_the_program_is_refused(rig: Rig) -> None:
    distributions = read_distributions((rig.packages, rig.product))
    with pytest.raises(UnknownFileError, match=r"holds no biosensor-gateway\.exe"):
        take_inventory(rig.bundle, [], distributions, CPython(rig.python))


def test_one_folder_may_hold_packages_and_product(rig: Rig) -> None:
    twice = read_distributions((rig.packages, rig.packages / "..", rig.packages))
    assert [each.name for each in twice] == ["used-package"]


# A small bundle to check, made by hand, and the reader of its program.
PROGRAM = "biosensor-gateway.exe"
PYTHON_DLL = b"MZ some code\x003.11.9\x00more code\x001.3.1\x00"
_FIXED_FILE_INFO = struct.pack("<IIII", 0xFEEF04BD, 0x10000, (14 << 16) | 40, 33810 << 16)
MICROSOFTS = "CompanyName\0\0Microsoft Corporation\0".encode("utf-16-le") + _FIXED_FILE_INFO


class Rig:
    """The folders that a bundle is completed from, with a product that uses one package."""

    def __init__(self, folder: Path) -> None:
        # bundle, packages, python, product, out: as :func:`installer.bundle.complete` takes them.
        self.bundle = folder / "bundle"
        self.packages = folder / "packages"
        self.python = folder / "python"
        self.product = folder / "product"
        self.out = folder / "out"
        self.scripts = ["frozen"]
        self.modules = ["biosensor_gateway", "ast"]
        self._install_python()
        gateway = {"biosensor_gateway/__init__.py": b"pass\n"}
        extra = ("License-Expression: Apache-2.0", "Requires-Dist: Used.Package>=1")
        self.install("biosensor-gateway", "1.2.3", gateway, extra, to=self.product)
        self.install("Used-Package", "1.0", {"used.py": b"pass\n", "used_c.pyd": b"MZ used"})
        self.modules.append("used")
        self.put("_internal/used_c.pyd", b"MZ used")

    def _install_python(self) -> None:
        for path, content in {
            "LICENSE.txt": b"The licence of Python\n",
            "python311.dll": PYTHON_DLL,
            "DLLs/_ssl.pyd": b"MZ ssl",
            "Lib/ast.py": b"pass\n",
            "Lib/abc.py": b"pass\n",
            "Lib/encodings/__init__.py": b"pass\n",
        }.items():
            _write(self.python / path, content)
        self.put("_internal/python311.dll", PYTHON_DLL)
        self.put_library("abc.pyc", "encodings/__init__.pyc")

    def put(self, path: str, content: bytes) -> None:
        """Put a file into the bundle."""
        _write(self.bundle / path, content)

    def put_library(self, *names: str) -> None:
        """Make the archive of the modules that Python starts with."""
        with zipfile.ZipFile(self.bundle / "_internal/base_library.zip", "w") as archive:
            for name in names:
                archive.writestr(zipfile.ZipInfo(name), b"code")

    def install(
        self,
        name: str,
        version: str,
        files: dict[str, bytes],
        metadata: Iterable[str] = ("License-Expression: MIT",),
        texts: dict[str, bytes] | None = None,
        to: Path | None = None,
    ) -> None:
        """Install a distribution, with a text of its licence unless others are given."""
        folder = to or self.packages
        info = f"{name.replace('-', '_')}-{version}.dist-info"
        head = ("Metadata-Version: 2.4", f"Name: {name}", f"Version: {version}", *metadata)
        contents = dict(files)
        contents[f"{info}/METADATA"] = ("\n".join(head) + "\n\n").encode()
        given = (
            {"licenses/LICENSE": f"The licence of {name}\n".encode()} if texts is None else texts
        )
        contents |= {f"{info}/{path}": content for path, content in given.items()}
        lines = [
            f"{path},{_recorded(content)},{len(content)}" for path, content in contents.items()
        ]
        contents[f"{info}/RECORD"] = "\n".join([*lines, f"{info}/RECORD,,"]).encode()
        for path, content in contents.items():
            _write(folder / path, content)

    def complete(self, **more: Any) -> None:
        """Freeze the program and complete the bundle."""
        self.put(PROGRAM, frozen_program(self.scripts, self.modules))
        complete(self.bundle, self.packages, self.python, self.product, self.out, **more)


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def _recorded(content: bytes) -> str:
    digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=")
    return f"sha256={digest.decode()}"


def frozen_program(
    scripts: Iterable[str], modules: Iterable[str], data: str | None = None
) -> bytes:
    """Make a program as PyInstaller 6 lays it out; ``data`` is a file packed into it."""
    table = [(name, (1, 0, 0)) for name in modules] + [("a_namespace", (3, 0, 0))]
    pyz = struct.pack("!4s4si", b"PYZ\0", b"magi", 12) + marshal.dumps(table)
    entries = [(name, b"s", b"code") for name in scripts] + [("PYZ-00.pyz", b"z", pyz)]
    entries += [("pyi-contents-directory _internal", b"o", b"")]
    entries += [] if data is None else [(data, b"x", b"data")]
    contents = b"".join(content for _, _, content in entries)
    toc, offset = b"", 0
    for name, kind, content in entries:
        encoded = name.encode().ljust(-(-(len(name) + 19) // 16) * 16 - 18, b"\0")
        sizes = (18 + len(encoded), offset, len(content), len(content))
        toc += struct.pack("!IIIIBc", *sizes, 0, kind) + encoded
        offset += len(content)
    length = len(contents) + len(toc) + 88
    cookie = struct.pack(
        "!8sIIII64s", b"MEI\x0c\x0b\x0a\x0b\x0e", length, offset, len(toc), 311, b"python311.dll"
    )
    return b"MZ bootloader" + contents + toc + cookie


def test_the_program_names_its_scripts_and_modules(tmp_path: Path) -> None:
    program = tmp_path / PROGRAM
    # A signature may follow the archive.
    program.write_bytes(frozen_program(["boot", "frozen"], ["a", "a.b"]) + b"signature")
    archive = read_archive(program)
    assert archive.scripts == ("boot", "frozen")
    assert archive.modules == ("a", "a.b")


FROZEN = frozen_program(["frozen"], ["a"])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        *((FROZEN[:left], r"biosensor-gateway\.exe is no program frozen")
          for left in (0, 40, -10, -88)),
        (FROZEN[100:], "cut off"),
        (frozen_program(["frozen"], ["a"], data="hidden.bin"), r"hidden\.bin"),
    ],
)  # fmt: skip
def test_a_program_that_is_cut_off_or_has_files_packed_into_it_is_refused(
    tmp_path: Path, content: bytes, said: str
) -> None:
    program = tmp_path / PROGRAM
    program.write_bytes(content)
    with pytest.raises(ArchiveError, match=said):
        read_archive(program)


# What the installed program consists of.

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
    assert (product["name"], product["version"]) == (BUNDLED, version())


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
        top = f"{BUNDLED}-{version()}/"
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
    assert f"{BIN}/{BUNDLED}.exe" in digests
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
    archive = read_archive(bundle / BIN / f"{BUNDLED}.exe")
    held = {*archive.scripts, *archive.modules}
    assert len(held) > 1000
    assert held <= set(properties(bom, MODULE))


@pytest.mark.system
def test_every_command_is_in_the_program(bundle: Path) -> None:
    # They are imported by name, which PyInstaller does not see.
    modules = {command.place.partition(":")[0] for command in COMMANDS}
    assert modules <= set(read_archive(bundle / BIN / f"{BUNDLED}.exe").modules)


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
    refuse_forbidden(bundle, files, read_archive(bundle / BIN / f"{BUNDLED}.exe").modules)


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
