"""Places and names of the build."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "installer"
WORK = ROOT / "build" / "installer"
DIST = ROOT / "dist"

PROGRAM = "biosensor-gateway"
# The program of the Start menu, without a console. Nobody types a name with a space by mistake.
WINDOWED = "Biosensor Gateway"
# What is tested under Wine is what is released: build.ps1, release.yml and the lock have this one.
PYTHON = "3.13.2"
# Of reproducible-builds.org.
TIME_VARIABLE = "SOURCE_DATE_EPOCH"
# Folder of the installation that has the program alone, for the PATH.
BIN = "bin"
PUBLISHER = "Biosensor Gateway contributors"


def version() -> str:
    """Return the version of the product: the one place is ``pyproject.toml``."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return str(project["version"])


def source_time() -> str:
    """Return when the sources were committed, Unix time in seconds; now if git does not know.

    A bill of materials tells it as its own time, so that the same sources give the same one.
    """
    given = os.environ.get(TIME_VARIABLE)
    if given:
        return given
    git = shutil.which("git")
    if git is None:
        return str(int(time.time()))
    command = [git, "-C", str(ROOT), "log", "-1", "--format=%ct"]
    asked = subprocess.run(command, capture_output=True, text=True, check=False)
    return asked.stdout.strip() or str(int(time.time()))


def portable_file() -> Path:
    """Where the program lies as an archive."""
    return DIST / f"{PROGRAM}-{version()}-portable.zip"


def setup_file() -> Path:
    """Where the finished installer lies."""
    return DIST / f"{PROGRAM}-{version()}-setup.exe"
