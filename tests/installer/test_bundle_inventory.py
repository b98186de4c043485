"""Everything in a bundle belongs to something, and nothing is in it that must not be."""

from __future__ import annotations

from pathlib import Path

import pytest

from installer.bundle.cpython import CPython
from installer.bundle.distributions import read_distributions
from installer.bundle.errors import ForbiddenFileError, UnknownFileError
from installer.bundle.inventory import take_inventory
from installer.bundle.model import Holding
from tests.installer.test_bundle_rig import MICROSOFTS, PROGRAM, Rig, frozen_program


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
