"""The installer around a program that does nothing but tell what it is asked, made in seconds."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from pathlib import Path

from installer.layout import PROGRAM, WINDOWED, WORK, version
from installer.wine.recipe import PICTURES

_HERE = Path(__file__).parent
_NSI = Path(__file__).parents[3] / "installer" / "biosensor-gateway.nsi"


def make_stub_setup(folder: Path) -> Path:
    """Build the installer's own script around the stub; return the installer."""
    setup = folder / f"{PROGRAM}-stub-setup.exe"
    program = folder / "bundle" / "bin" / f"{PROGRAM}.exe"
    (program.parent / "_internal").mkdir(parents=True)
    _compile(_HERE / "stub.nsi", {"OUTPUT": program})
    (program.parent / f"{WINDOWED}.exe").write_bytes(b"MZ")
    (program.parent / "_internal" / "python.dll").write_bytes(b"MZ")
    (folder / "bundle" / "docs").mkdir()
    (folder / "bundle" / "docs" / "index.html").write_text("<p>")
    defined = {
        "VERSION": version(),
        "PICTURES": WORK / PICTURES.name,
        "COPY": "cp",
        "UNINSTALLER": folder / "uninstall.exe",
        "OUTPUT": setup,
        "BUNDLE": folder / "bundle",
    }
    _compile(_NSI, defined)
    return setup


def _compile(script: Path, defined: Mapping[str, str | Path]) -> None:
    subprocess.run(
        [
            *("makensis", "-V2", "-WX", "-INPUTCHARSET", "UTF8"),
            *(f"-D{name}={value}" for name, value in defined.items()),
            script,
        ],
        check=True,
    )
