"""Places and names of the build."""

from __future__ import annotations

import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "installer"
WORK = ROOT / "build" / "installer"
DIST = ROOT / "dist"

PROGRAM = "biosensor-gateway"
PUBLISHER = "Biosensor Gateway contributors"


def version() -> str:
    """Return the version of the product: the one place is ``pyproject.toml``."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return str(project["version"])


def setup_file() -> Path:
    """Where the finished installer lies."""
    return DIST / f"{PROGRAM}-{version()}-setup.exe"
