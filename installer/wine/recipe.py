"""The stages of the build under Wine."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from pathlib import Path

from installer import manual, pictures, portable
from installer.bundle import complete
from installer.layout import (
    BIN,
    DIST,
    PROGRAM,
    ROOT,
    SOURCES,
    TIME_VARIABLE,
    WORK,
    portable_file,
    setup_file,
    source_time,
    version,
)
from installer.stages import STAMP, Stage
from installer.wine import inputs
from installer.wine.prefix import Prefix, make_prefix, windows_path

_PORTABLE = "portable"
# Against a hang; a busy machine takes a quarter of it.
_FREEZE_LIMIT_S = 3600.0
_LOCK = ROOT / "requirements" / "freeze.txt"
_PRODUCT = (
    ROOT / "pyproject.toml",
    ROOT / "LICENSE",
    ROOT / "README.md",
    ROOT / "hatch_build.py",
    ROOT / "common" / "biosensor_common",
    ROOT / "gateway_win" / "biosensor_gateway",
)


def _unpack_python(folder: Path) -> None:
    inputs.unpack_python(WORK / DOWNLOADS.name, folder)


def _install_packages(folder: Path) -> None:
    inputs.install_packages(_LOCK, folder)


def _install_product(folder: Path) -> None:
    inputs.install_product(folder)


def _make_prefix(folder: Path) -> None:
    make_prefix(folder, inputs.ucrtbase(WORK / DOWNLOADS.name)).end()


def _freeze(folder: Path) -> None:
    prefix = Prefix(
        WORK / PREFIX.name,
        {
            "PYTHONPATH": ";".join(windows_path(WORK / each.name) for each in (PRODUCT, PACKAGES)),
            "PYTHONHASHSEED": "0",
            # PyInstaller asks many short-lived Pythons, all of which import the same; what they
            # have compiled must not lie among the packages, for those are what is shipped.
            "PYTHONDONTWRITEBYTECODE": "",
            "PYTHONPYCACHEPREFIX": windows_path(folder / "bytecode"),
            "GATEWAY_VERSION": version(),
            "GATEWAY_FROZEN": windows_path(SOURCES / "frozen.py"),
            "GATEWAY_ICON": windows_path(WORK / PICTURES.name / pictures.ICON),
        },
    )
    options = ("--noconfirm", "--clean", "--log-level", "WARN")
    folders = ("--distpath", windows_path(folder), "--workpath", windows_path(folder / "work"))
    spec = windows_path(SOURCES / "biosensor-gateway.spec")
    python = WORK / PYTHON.name / "python.exe"
    try:
        (folder / "freeze.log").write_text(
            prefix.run(
                python, "-m", "PyInstaller", *options, *folders, spec, timeout=_FREEZE_LIMIT_S
            ),
            encoding="utf-8",
        )
    finally:
        prefix.end()


def _uninstaller(folder: Path) -> None:
    # Its installer, which has nothing to install, is of no use.
    _make_setup(folder, folder / "nothing.exe")


def _bundle(folder: Path) -> None:
    bundle = folder / PROGRAM
    documents = WORK / MANUAL.name
    shutil.copytree(WORK / FREEZE.name / PROGRAM, bundle / BIN)
    shutil.copytree(documents, bundle / "docs", ignore=shutil.ignore_patterns(STAMP))
    parts = (bundle / BIN, WORK / PACKAGES.name, WORK / PYTHON.name, WORK / PRODUCT.name)
    # An archive has no uninstaller, and so another bill.
    for out, uninstaller in ((bundle, _UNINSTALLED), (folder / _PORTABLE, None)):
        os.environ.setdefault(TIME_VARIABLE, source_time())
        complete(*parts, out, below=BIN, documents=documents, uninstaller=uninstaller)


def _portable(folder: Path) -> None:
    unpacked = folder / "unpacked"
    # Its licences and its bill are its own.
    shutil.copytree(WORK / BUNDLE.name / _PORTABLE, unpacked)
    for part in (BIN, "docs"):
        shutil.copytree(WORK / BUNDLE.name / PROGRAM / part, unpacked / part)
    archive = folder / portable_file().name
    portable.pack(unpacked, archive)
    shutil.rmtree(unpacked)
    _publish(archive)


def _package(folder: Path) -> None:
    setup = folder / setup_file().name
    _make_setup(folder, setup, f"-DBUNDLE={WORK / BUNDLE.name / PROGRAM}")
    if (folder / _UNINSTALLED.name).read_bytes() != _UNINSTALLED.read_bytes():
        raise RuntimeError("the installer has another uninstaller than its bill of materials")
    _publish(setup)


def _make_setup(folder: Path, output: Path, *more: str) -> None:
    defined = {
        "VERSION": version(),
        "PICTURES": WORK / PICTURES.name,
        "COPY": "cp",
        "UNINSTALLER": folder / _UNINSTALLED.name,
        "OUTPUT": output,
    }
    subprocess.run(
        [
            *("makensis", "-V2", "-WX", "-INPUTCHARSET", "UTF8"),
            *(f"-D{name}={value}" for name, value in defined.items()),
            *more,
            SOURCES / "biosensor-gateway.nsi",
        ],
        check=True,
    )


def _publish(file: Path) -> None:
    DIST.mkdir(exist_ok=True)
    shutil.copyfile(file, DIST / file.name)
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    checksum = DIST / f"{file.name}.sha256"
    checksum.write_text(f"{digest}  {file.name}\n", encoding="ascii")


DOWNLOADS = Stage("downloads", inputs.download, inputs=(SOURCES / "inputs.txt",))
PYTHON = Stage(
    "python",
    _unpack_python,
    inputs=(SOURCES / "wine" / "inputs.py", SOURCES / "layout.py"),
    after=(DOWNLOADS,),
)
PACKAGES = Stage("packages", _install_packages, inputs=(_LOCK, SOURCES / "layout.py"))
PREFIX = Stage(
    "prefix",
    _make_prefix,
    inputs=(SOURCES / "wine" / "prefix.py", SOURCES / "wine" / "forwarder.py"),
    after=(DOWNLOADS,),
)
PICTURES = Stage("pictures", pictures.draw, inputs=(SOURCES / "pictures.py",))
_DOCUMENTS = ("docs", "README.md", "CONTRIBUTING.md", "CHANGELOG.md")
MANUAL = Stage(
    "manual",
    manual.write,
    inputs=(SOURCES / "manual.py", *(ROOT / each for each in _DOCUMENTS)),
)
PRODUCT = Stage("product", _install_product, inputs=_PRODUCT)
FREEZE = Stage(
    "freeze",
    _freeze,
    inputs=tuple(SOURCES / each for each in ("biosensor-gateway.spec", "frozen.py", "windowed.py")),
    after=(PYTHON, PACKAGES, PREFIX, PICTURES, PRODUCT),
)
_NSIS = (SOURCES / "biosensor-gateway.nsi",)
UNINSTALLER = Stage("uninstaller", _uninstaller, inputs=_NSIS, after=(PICTURES,))
_UNINSTALLED = WORK / UNINSTALLER.name / "uninstall.exe"
BUNDLE = Stage(
    "bundle",
    _bundle,
    inputs=(SOURCES / "bundle",),
    after=(FREEZE, MANUAL, UNINSTALLER),
)
PORTABLE = Stage("portable", _portable, inputs=(SOURCES / "portable.py",), after=(BUNDLE,))
PACKAGE = Stage("package", _package, inputs=_NSIS, after=(BUNDLE,))

STAGES = (
    *(DOWNLOADS, PYTHON, PACKAGES, PREFIX, PICTURES, MANUAL, PRODUCT, FREEZE),
    *(UNINSTALLER, BUNDLE, PORTABLE, PACKAGE),
)
