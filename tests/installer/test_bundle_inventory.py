"""Everything in a bundle belongs to something, in small bundles made by hand."""

from __future__ import annotations

import base64
import hashlib
import marshal
import struct
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from installer.bundle import complete
from installer.bundle.archive import read_archive
from installer.bundle.cpython import CPython
from installer.bundle.distributions import read_distributions
from installer.bundle.errors import ArchiveError, ForbiddenFileError, UnknownFileError
from installer.bundle.inventory import take_inventory
from installer.bundle.model import Holding

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
    """The folders that a bundle is completed from, with a product that uses one package.

    Attributes
    ----------
    bundle, packages, python, product, out
        As :func:`installer.bundle.complete` takes them.
    """

    def __init__(self, folder: Path) -> None:
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


@pytest.mark.parametrize("left", [0, 40, -10, -88])
def test_a_program_that_is_cut_off_is_refused(tmp_path: Path, left: int) -> None:
    program = tmp_path / PROGRAM
    program.write_bytes(frozen_program(["frozen"], ["a"])[:left])
    with pytest.raises(ArchiveError, match=r"biosensor-gateway\.exe is no program frozen"):
        read_archive(program)


def test_a_program_whose_front_is_missing_is_refused(tmp_path: Path) -> None:
    program = tmp_path / PROGRAM
    program.write_bytes(frozen_program(["frozen"], ["a"])[100:])
    with pytest.raises(ArchiveError, match="cut off"):
        read_archive(program)


def test_a_program_with_files_packed_into_it_is_refused(tmp_path: Path) -> None:
    program = tmp_path / PROGRAM
    program.write_bytes(frozen_program(["frozen"], ["a"], data="hidden.bin"))
    with pytest.raises(ArchiveError, match=r"hidden\.bin"):
        read_archive(program)
