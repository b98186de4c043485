"""The stages of the build under Wine."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from pathlib import Path

from installer.bundle import complete
from installer.layout import DIST, PROGRAM, ROOT, SOURCES, WORK, setup_file, version
from installer.stages import Stage
from installer.wine import inputs
from installer.wine.prefix import Prefix, make_prefix, windows_path

_LOCK = ROOT / "requirements" / "freeze.txt"
_PRODUCT = (
    ROOT / "pyproject.toml",
    ROOT / "LICENSE",
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
            "GATEWAY_VERSION": version(),
            "GATEWAY_FROZEN": windows_path(SOURCES / "frozen.py"),
        },
    )
    options = ("--noconfirm", "--clean", "--log-level", "WARN")
    folders = ("--distpath", windows_path(folder), "--workpath", windows_path(folder / "work"))
    spec = windows_path(SOURCES / "biosensor-gateway.spec")
    python = WORK / PYTHON.name / "python.exe"
    try:
        (folder / "freeze.log").write_text(
            prefix.run(python, "-m", "PyInstaller", *options, *folders, spec, timeout=900.0),
            encoding="utf-8",
        )
    finally:
        prefix.end()


def _bundle(folder: Path) -> None:
    bundle = folder / PROGRAM
    shutil.copytree(WORK / FREEZE.name / PROGRAM, bundle)
    complete(bundle, WORK / PACKAGES.name, WORK / PYTHON.name, WORK / PRODUCT.name, bundle)


def _package(folder: Path) -> None:
    setup = folder / setup_file().name
    defined = {"VERSION": version(), "BUNDLE": WORK / BUNDLE.name / PROGRAM, "OUTPUT": setup}
    subprocess.run(  # noqa: S603 - found on PATH, as everywhere
        [
            *("makensis", "-V2", "-WX", "-INPUTCHARSET", "UTF8"),
            *(f"-D{name}={value}" for name, value in defined.items()),
            SOURCES / "biosensor-gateway.nsi",
        ],
        check=True,
    )
    DIST.mkdir(exist_ok=True)
    content = setup.read_bytes()
    setup_file().write_bytes(content)
    digest = hashlib.sha256(content).hexdigest()
    checksum = setup_file().with_suffix(".exe.sha256")
    checksum.write_text(f"{digest}  {setup_file().name}\n", encoding="ascii")


DOWNLOADS = Stage("downloads", inputs.download, inputs=(SOURCES / "inputs.txt",))
PYTHON = Stage(
    "python", _unpack_python, inputs=(SOURCES / "wine" / "inputs.py",), after=(DOWNLOADS,)
)
PACKAGES = Stage("packages", _install_packages, inputs=(_LOCK,))
PREFIX = Stage(
    "prefix",
    _make_prefix,
    inputs=(SOURCES / "wine" / "prefix.py", SOURCES / "wine" / "forwarder.py"),
    after=(DOWNLOADS,),
)
PRODUCT = Stage("product", _install_product, inputs=_PRODUCT)
FREEZE = Stage(
    "freeze",
    _freeze,
    inputs=(SOURCES / "biosensor-gateway.spec", SOURCES / "frozen.py"),
    after=(PYTHON, PACKAGES, PREFIX, PRODUCT),
)
BUNDLE = Stage("bundle", _bundle, inputs=(SOURCES / "bundle",), after=(FREEZE,))
PACKAGE = Stage(
    "package",
    _package,
    inputs=(SOURCES / "biosensor-gateway.nsi",),
    after=(BUNDLE,),
)

STAGES = (DOWNLOADS, PYTHON, PACKAGES, PREFIX, PRODUCT, FREEZE, BUNDLE, PACKAGE)
